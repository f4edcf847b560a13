"""Meshes that the projection is tried on, and a float64 reference made of trimesh's closest points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from ndf_mi.projection import PosedSurface, Surface


@dataclass(frozen=True)
class Mesh:
    """A mesh with an atlas in which every triangle has a chart of its own: each edge is a seam."""

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    side: int

    def surface(self) -> Surface:
        return Surface(self.faces, self.uv, self.uv_faces, self.vertices)

    def pose(self, band: float = 0.2) -> PosedSurface:
        return PosedSurface(self.surface(), mi.Float(self.vertices.astype(np.float32).ravel()), band)

    def point_of_uv(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The triangle whose chart (u, v) lies in, and the surface's point there, from (u, v) alone."""
        cell = np.floor(uv * self.side).astype(int)
        triangle = cell[:, 1] * self.side + cell[:, 0]
        a, b, c = (self.uv[self.uv_faces[triangle, k]].astype(np.float64) for k in range(3))
        basis = np.stack([b - a, c - a], axis=2)
        s = np.linalg.solve(basis, (uv - a)[:, :, None])[:, :, 0]
        weights = np.concatenate([1 - s.sum(1, keepdims=True), s], axis=1)
        return triangle, (self.vertices[self.faces[triangle]] * weights[:, :, None]).sum(1)


def charted(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Gives every triangle a chart in a square of a grid."""
    count = len(faces)
    side = int(np.ceil(np.sqrt(count)))
    corner = np.stack([np.arange(count) % side, np.arange(count) // side], axis=1)
    offsets = np.array([[0.1, 0.1], [0.8, 0.2], [0.3, 0.9]])
    uv = ((corner[:, None] + offsets) / side).reshape(-1, 2).astype(np.float32)
    return Mesh(vertices, np.asarray(faces), uv, np.arange(3 * count).reshape(-1, 3), side)


def bumpy() -> Mesh:
    """A closed mesh of 1,280 triangles with hollows and ridges, about a metre across."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = sphere.vertices.T
    radius = 0.5 + 0.12 * np.sin(5 * x) * np.cos(4 * y) + 0.05 * np.sin(9 * z)
    vertices = (sphere.vertices * radius[:, None]).astype(np.float32).astype(np.float64)
    return charted(vertices, sphere.faces)


@pytest.fixture(scope="session")
def mesh() -> Mesh:
    return bumpy()


@pytest.fixture(scope="session")
def chart() -> Callable[[np.ndarray, np.ndarray], Mesh]:
    return charted


def closest64(mesh: Mesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance to every triangle by float64 brute force, of the nearest: (N,) distances and (N,) triangles.
    """
    triangles = mesh.vertices[mesh.faces].astype(np.float64)
    distance, nearest = np.full(len(points), np.inf), np.zeros(len(points), int)
    for i, triangle in enumerate(triangles):
        on = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(points), 3, 3)), points)
        d = np.linalg.norm(points - on, axis=1)
        nearer = d < distance
        distance[nearer], nearest[nearer] = d[nearer], i
    return distance, nearest


@pytest.fixture(scope="session")
def reference() -> Callable[[Mesh, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    return closest64


@pytest.fixture(scope="session")
def points() -> Callable[..., mi.Point3f]:
    """(N, 3) numpy to Dr.Jit."""
    return lambda array: mi.Point3f(np.ascontiguousarray(np.asarray(array, np.float32).T))


def around(mesh: Mesh, count: int, spread: float, seed: int = 0) -> np.ndarray:
    """Points about the surface: on random triangles, moved by up to ``spread`` in any direction; float32
    values."""
    rng = np.random.default_rng(seed)
    triangle = rng.integers(len(mesh.faces), size=count)
    weights = rng.dirichlet((1, 1, 1), count)
    on = (mesh.vertices[mesh.faces[triangle]] * weights[:, :, None]).sum(1)
    way = rng.normal(size=(count, 3))
    way *= rng.uniform(0, spread, (count, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    return (on + way).astype(np.float32).astype(np.float64)


@pytest.fixture(scope="session")
def scatter() -> Callable[..., np.ndarray]:
    return around
