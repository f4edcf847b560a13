"""The parts of a surface that no pose changes: faces, texture coordinates and the search tree's topology."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.mesh import opposite_half_edges
from ndf_mi.errors import InputError


@dataclass(frozen=True)
class Tree:
    """A complete binary tree over pairs of adjacent triangles, in heap order (root 1, children 2n and 2n +
    1).

    Leaf slot ``i`` is node ``leaves + i``. A slot past the number of pairs repeats another pair and is not
    ``occupied``.

    Attributes:
        depth: levels below the root; there are ``2 ** depth`` leaves, and at least one level.
        corners: (leaves, 4) uint32, vertices a, b, c, d of the two triangles (a, b, c) and (a, c, d); a
            triangle without a partner has d = c.
        triangles: (leaves, 2) uint32, the mesh's triangles that these are; the same one twice without a
            partner.
        occupied: (leaves,) bool.
    """

    depth: int
    corners: np.ndarray
    triangles: np.ndarray
    occupied: np.ndarray


def pair_triangles(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joins triangles across shared edges, the edge that is longest for its two triangles first.

    Two triangles of a pair share two vertices, so that a leaf reads four vertices for two triangles.

    Returns:
        (P, 4) corners and (P, 2) triangles, as in :class:`Tree`.
    """
    opposite = opposite_half_edges(faces).reshape(faces.shape)
    corner = vertices[faces]
    length = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2)
    share = length / np.maximum(length.sum(1, keepdims=True), np.finfo(np.float64).tiny)
    t, k = np.nonzero(opposite // 3 > np.arange(len(faces))[:, None])
    n, m = np.divmod(opposite[t, k], 3)
    order = np.argsort(-(share[t, k] + share[n, m]), kind="stable")
    free = np.ones(len(faces), bool)
    chosen = []
    for i in order.tolist():
        if free[t[i]] and free[n[i]]:
            free[t[i]] = free[n[i]] = False
            chosen.append(i)
    single = np.nonzero(free)[0]
    t, k, n, m = (np.asarray(part[chosen], np.int64) for part in (t, k, n, m))
    # Edge k of t runs from c to a: the diagonal that both triangles share.
    columns = [faces[t, (k + 1) % 3], faces[t, (k + 2) % 3], faces[t, k], faces[n, (m + 2) % 3]]
    alone = faces[single][:, [0, 1, 2, 2]]
    corners = np.concatenate([np.stack(columns, axis=1), alone])
    triangles = np.concatenate([np.stack([t, n], axis=1), np.stack([single, single], axis=1)])
    return corners.astype(np.uint32), triangles.astype(np.uint32)


def build_tree(vertices: np.ndarray, faces: np.ndarray) -> Tree:
    """A balanced tree of the pairs, split at the median along the longest side of the boxes of their
    centres."""
    corners, triangles = pair_triangles(vertices, faces)
    count = len(corners)
    depth = max(1, int(np.ceil(np.log2(count))))
    points = vertices[corners]
    centre = 0.5 * (points.min(1) + points.max(1))
    order = np.arange(count)
    for level in range(depth):
        bounds = (np.arange((1 << level) + 1) * count) >> level
        segment = np.repeat(np.arange(1 << level), np.diff(bounds))
        begin = np.minimum(bounds[:-1], count - 1)
        at = centre[order]
        side = np.maximum.reduceat(at, begin) - np.minimum.reduceat(at, begin)
        axis = np.argmax(side, axis=1)[segment]
        order = order[np.lexsort((at[np.arange(count), axis], segment))]
    bounds = (np.arange((1 << depth) + 1) * count) >> depth
    slot = order[np.minimum(bounds[:-1], count - 1)]
    return Tree(depth, corners[slot], triangles[slot], np.diff(bounds) > 0)


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
        leaf_corners, leaf_triangles, leaf_occupied: as in :class:`ndf_mi.projection.surface.Tree`.

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
            found = "a mesh without texture coordinates"
            raise InputError("uv", found, "uv and uv_faces", "Give the mesh an atlas.")
        vertices, uv = np.asarray(reference_vertices, np.float64), np.asarray(uv, np.float32)
        for name, array, columns in (("reference_vertices", vertices, 3), ("uv", uv, 2)):
            if array.ndim != 2 or array.shape[1] != columns or not np.isfinite(array).all():
                raise InputError(name, f"shape {array.shape}", f"(N, {columns}) finite numbers")
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
        found = f"shape {array.shape} of {array.dtype}"
        raise InputError(name, found, "(F, 3) integers, at least one triangle")
    array = array.astype(np.int64)
    if array.min() < 0 or array.max() >= count:
        raise InputError(name, f"indices from {array.min()} to {array.max()}", f"from 0 to {count - 1}")
    return array
