"""Flattens a disk: a map onto a circle that cannot fold, then libigl's scaffold method.

The scaffold method (Jiang, Schaefer and Panozzo, "Simplicial complex augmentation framework for bijective
maps", SIGGRAPH Asia 2017) also triangulates the space around the chart. While the symmetric Dirichlet energy
falls, no triangle of the chart can flip and its boundary cannot intersect itself.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh
from scipy import sparse
from scipy.sparse import csgraph, linalg

from ndf_mi.body import atlas_mesh as mesh
from ndf_mi.optional import require

_BATCH = 3
_MOST_BATCHES = 25
_SETTLED = 1e-3


def harmonic_disk(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The harmonic map (cotangent weights) of a disk of V vertices onto the unit disk, (V, 2) float64.

    The boundary is placed on the circle by arc length. Obtuse triangles may flip: see `tutte_disk`.
    """
    igl = require("igl", extra="atlas")
    loop, circle = _circle(points, faces)
    return np.asarray(igl.harmonic(np.ascontiguousarray(points), np.ascontiguousarray(faces, np.int64), loop,
                                   circle, 1))


def tutte_disk(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Tutte's embedding: as `harmonic_disk`, with each inner vertex at the mean of its neighbours. Only
    rounding can flip a triangle."""
    loop, circle = _circle(points, faces)
    count = len(points)
    ahead = trimesh.graph.edges_to_coo(trimesh.geometry.faces_to_edges(faces), count).tocsr()
    laplacian = sparse.csr_matrix(csgraph.laplacian((ahead + ahead.T).astype(np.float64)))
    inner = np.setdiff1d(np.arange(count), loop)
    flat = np.zeros((count, 2))
    flat[loop] = circle
    if len(inner):
        system = sparse.csc_matrix(laplacian[inner][:, inner])
        flat[inner] = linalg.splu(system).solve(-(laplacian[inner][:, loop] @ circle))
    return flat


def _circle(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices of the one boundary loop, and their positions on the unit circle."""
    (loop,) = mesh.boundary_loops(faces, mesh.opposites(faces))
    length = np.linalg.norm(points[np.roll(loop, -1)] - points[loop], axis=1)
    length = np.maximum(length, 1e-3 * length.mean())
    angle = 2 * np.pi * (np.cumsum(length) - length) / length.sum()
    return loop, np.stack([np.cos(angle), np.sin(angle)], axis=1)


def start(points: np.ndarray, faces: np.ndarray) -> np.ndarray | None:
    """The harmonic map, or else Tutte's, scaled to the area of the surface; None if both flip triangles."""
    area = trimesh.triangles.area(points[faces]).sum()
    for method in (harmonic_disk, tutte_disk):
        flat = method(points, faces) * np.sqrt(area / np.pi)
        if np.isfinite(flat).all() and trimesh.triangles.cross(flat[faces]).min() > 0:
            return flat
    return None


def relaxed(points: np.ndarray, faces: np.ndarray, flat: np.ndarray) -> Iterator[np.ndarray]:
    """Maps with ever lower symmetric Dirichlet energy, (V, 2) float64, from one without flips.

    The boundary is free. It ends when three iterations gain less than a thousandth, or after 75 iterations.
    """
    igl, triangle = require("igl", extra="atlas"), require("igl.triangle", extra="atlas")
    # The weights of the method are absolute, for a surface of area 1.
    scale = np.sqrt(trimesh.triangles.area(points[faces]).sum())
    data = triangle.SCAFData()
    triangle.scaf_precompute(
        np.asfortranarray(points / scale), np.asfortranarray(faces, np.int32),
        np.asfortranarray(flat / scale),
        igl.MappingEnergyType.SYMMETRIC_DIRICHLET, np.zeros(0, np.int32), np.zeros((0, 2), order="F"), 0.0,
        data,
    )  # fmt: skip
    before = np.inf
    for _ in range(_MOST_BATCHES):
        flat = np.array(triangle.scaf_solve(_BATCH, data))[: len(points), :2] * scale
        yield flat
        energy = symmetric_dirichlet(points, faces, flat)
        if not energy < (1 - _SETTLED) * before:
            return
        before = energy


def stretches(points: np.ndarray, faces: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """(F, 2) float64 singular values of each triangle's map to the plane, the larger first."""
    a, b = np.moveaxis(points[faces[:, 1:]] - points[faces[:, :1]], 1, 0)
    along = a / np.linalg.norm(a, axis=1, keepdims=True)
    x = np.einsum("ij,ij->i", b, along)
    y = np.linalg.norm(b - x[:, None] * along, axis=1)
    p, q = np.moveaxis(flat[faces[:, 1:]] - flat[faces[:, :1]], 1, 0)
    first = p / np.linalg.norm(a, axis=1, keepdims=True)
    second = (q - x[:, None] * first) / y[:, None]
    return np.linalg.svd(np.stack([first, second], axis=2), compute_uv=False)


def symmetric_dirichlet(points: np.ndarray, faces: np.ndarray, flat: np.ndarray) -> float:
    """Mean over the surface of (σ₁² + σ₂² + σ₁⁻² + σ₂⁻²)/4: 1 for an isometry, more for anything else."""
    with np.errstate(divide="ignore"):
        squared = stretches(points, faces, flat) ** 2
        energy = (squared + 1 / squared).sum(1) / 4
    return float(np.average(energy, weights=trimesh.triangles.area(points[faces])))
