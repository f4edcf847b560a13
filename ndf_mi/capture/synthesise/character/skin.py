"""What a camera can see of a character: points of its outer surface, which the body is fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from ndf_mi.body.mesh import vertex_normals
from ndf_mi.mitsuba_mesh import make_mesh

_DIRECTIONS = 64
#: A point counts as seen if this many of the directions are free; fewer are inside mouths and sleeves.
_FREE = 4


@dataclass(frozen=True)
class Mesh:
    """All parts of a character as one mesh.

    Attributes:
        vertices: (T, N, 3) metres, in T frames.
        faces: (F, 3).
        same: (N,) one number for all vertices that are one point of a smooth surface.
    """

    vertices: np.ndarray
    faces: np.ndarray
    same: np.ndarray

    def normals(self, frame: int) -> np.ndarray:
        """(N, 3) unit normals, smooth over texture seams."""
        welded = np.zeros((self.same.max() + 1, 3))
        welded[self.same] = self.vertices[frame]
        return vertex_normals(welded, self.same[self.faces])[self.same]


class Skin:
    """K points of the outer surface in T frames.

    Args:
        mesh: the character; what is seen is decided in its first frame.
        count: how many points to draw on all of the surface.
        seed: of the draw.
    """

    def __init__(self, mesh: Mesh, count: int, seed: int) -> None:
        start = trimesh.Trimesh(mesh.vertices[0], mesh.faces, process=False)
        drawn, index = trimesh.sample.sample_surface(start, count, seed=seed)
        corners = trimesh.triangles.points_to_barycentric(start.triangles[index], drawn)
        corners = np.nan_to_num(corners).clip(0, 1)
        chosen = mesh.faces[index]
        seen = _seen(mesh, np.asarray(drawn), np.asarray(start.face_normals[index]))
        corners, chosen = corners[seen][..., None], chosen[seen]
        normals = (mesh.normals(t) for t in range(len(mesh.vertices)))
        self.points = np.stack([(v[chosen] * corners).sum(axis=1) for v in mesh.vertices])
        self.normals = np.stack([(n[chosen] * corners).sum(axis=1) for n in normals])
        self.normals /= np.maximum(np.linalg.norm(self.normals, axis=-1, keepdims=True), 1e-9)
        self._trees = [cKDTree(points) for points in self.points]

    def heights(self, frame: int, points: np.ndarray, normals: np.ndarray,
                reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How far points with normals, (P, 3) each, are outside of the surface in a frame.

        Returns:
            (P,) metres along the surface's normal, negative inside; (P, 3) that normal; (P,) bool whether
            there is a surface within ``reach`` that faces the same way.
        """
        away, nearest = self._trees[frame].query(points)
        facing = self.normals[frame][nearest]
        height = np.einsum("pi,pi->p", points - self.points[frame][nearest], facing)
        return height, facing, (away < reach) & (np.einsum("pi,pi->p", facing, normals) > 0.4)


def _seen(mesh: Mesh, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(P,) bool: whether light from some directions reaches the points, on the side of their normals."""
    surface = make_mesh("character", mesh.vertices[0], mesh.faces)
    scene = mi.load_dict({"type": "scene", "surface": surface})
    spread = np.arange(_DIRECTIONS) + 0.5
    height, angle = 1 - 2 * spread / _DIRECTIONS, np.pi * (1 + 5**0.5) * spread
    flat = np.sqrt(1 - height**2)
    free = np.zeros(len(points), dtype=int)
    starts = mi.Point3f(np.ascontiguousarray((points + 1e-3 * normals).T, dtype=np.float32))
    for direction in np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], axis=1):
        hit = np.array(scene.ray_test(mi.Ray3f(starts, mi.Vector3f(direction.tolist()))))
        free += ~hit & (normals @ direction > 0)
    return free >= _FREE
