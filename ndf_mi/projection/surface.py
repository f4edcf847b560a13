"""The parts of a surface that no pose changes: faces, texture coordinates and the search tree's topology."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.mesh import opposite_half_edges
from ndf_mi.errors import InputError
from ndf_mi.projection.topology import build_tree


def aligned(array: mi.Float | mi.UInt32) -> mi.Float | mi.UInt32:
    """A copy in Dr.Jit's own memory, aligned for reads of several values at once."""
    array = dr.gather(type(array), array, dr.arange(mi.UInt32, dr.width(array)))
    dr.eval(array)
    return array


class Surface:
    """A textured triangle mesh, independent of its pose; :class:`ndf_mi.projection.PosedSurface` poses it.

    Args:
        faces: (F, 3) integers into the vertices, counter-clockwise seen from outside.
        uv: (U, 2) texture coordinates.
        uv_faces: (F, 3) integers into ``uv``: texture coordinates belong to corners, so that seams cost
            nothing.
        reference_vertices: (V, 3) any usual pose, metres; the tree's topology is chosen for it.

    Attributes:
        vertex_count, face_count: V and F.
        depth: levels of the search tree below its root.
        faces: flat (3·F) vertices.
        neighbours: flat (3·F); the triangle across each edge, or the triangle itself at a boundary.
        corner_uv: flat (6·F) texture coordinates.
        leaf_corners, leaf_triangles, leaf_occupied: as in :class:`ndf_mi.projection.topology.Tree`.

    Raises:
        InputError: a shape, an index or a value is not as above.

    The mesh may have boundaries, and edges that more than two triangles share; there the sign of the distance
    is that of the triangle's own plane. Needs an active variant.
    """

    def __init__(
        self, faces: np.ndarray, uv: np.ndarray | None, uv_faces: np.ndarray | None,
        reference_vertices: np.ndarray,
    ) -> None:
        if uv is None or uv_faces is None:
            raise InputError("uv", "a mesh without texture "
                                   "coordinates", "uv and uv_faces", "Give the mesh an atlas.")
        vertices = np.asarray(reference_vertices, np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise InputError("reference_vertices", f"shape {vertices.shape}", "(V, 3) finite numbers")
        uv = np.asarray(uv, np.float32)
        if uv.ndim != 2 or uv.shape[1] != 2 or not np.isfinite(uv).all():
            raise InputError("uv", f"shape {uv.shape}", "(U, 2) finite numbers")
        triangles = _checked_faces("faces", faces, len(vertices))
        corners = _checked_faces("uv_faces", uv_faces, len(uv))
        if len(triangles) != len(corners):
            raise InputError("uv_faces", f"{len(corners)} triangles", f"{len(triangles)}, as many as faces")

        self.vertex_count = len(vertices)
        self.face_count = len(triangles)
        tree = build_tree(vertices, triangles)
        self.depth = tree.depth
        opposite = opposite_half_edges(triangles)
        own = np.repeat(np.arange(self.face_count), 3)
        self.faces = _index(triangles)
        self.neighbours = _index(np.where(opposite >= 0, opposite // 3, own))
        self.corner_uv = aligned(mi.Float(np.ascontiguousarray(uv[corners]).ravel()))
        self.leaf_corners = _index(tree.corners)
        self.leaf_triangles = _index(tree.triangles)
        self.leaf_occupied = mi.Bool(tree.occupied)

    @property
    def leaves(self) -> int:
        """Leaves of the search tree, a power of two."""
        return 1 << self.depth


def _index(array: np.ndarray) -> mi.UInt32:
    return aligned(mi.UInt32(np.ascontiguousarray(array, np.uint32).ravel()))


def _checked_faces(name: str, faces: np.ndarray, count: int) -> np.ndarray:
    array = np.asarray(faces)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array) or not np.issubdtype(array.dtype, np.integer):
        raise InputError(name, f"shape {array.shape} of "
                               f"{array.dtype}", "(F, 3) integers, at least one triangle")
    array = array.astype(np.int64)
    if array.min() < 0 or array.max() >= count:
        raise InputError(name, f"indices from {array.min()} to {array.max()}", f"from 0 to {count - 1}")
    return array
