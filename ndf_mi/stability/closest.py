"""Closest points on triangle meshes in float64, by trying every triangle: the reference of the projection's cases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_AT_ONCE = 1 << 21


@dataclass(frozen=True)
class Closest:
    """The closest point of each of N queries: `triangle` (N,), `weights` (N, 3) of its corners, `point` (N, 3) and `distance` (N,)."""

    triangle: np.ndarray
    weights: np.ndarray
    point: np.ndarray
    distance: np.ndarray


def on_triangles(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(…, 3) weights of the closest points to x (…, 3) on triangles (…, 3, 3).

    The foot of the perpendicular onto the plane where it is inside, else the nearest point of the three edges; whichever is closer.
    """
    x, corners = np.broadcast_arrays(x[..., None, :], corners)
    x = x[..., 0, :]
    a, b, c = (corners[..., k, :] for k in range(3))
    normal = np.cross(b - a, c - a)
    square = np.einsum("...i,...i", normal, normal)
    flat = square <= 1e-32 * np.einsum("...i,...i", b - a, b - a) * np.einsum("...i,...i", c - a, c - a)
    safe = np.where(flat, 1.0, square)
    areas = [np.einsum("...i,...i", np.cross(end - start, x - start), normal) / safe for start, end in ((b, c), (c, a), (a, b))]
    face = np.stack(areas, -1)
    best = np.where(((face >= 0).all(-1) & ~flat)[..., None], face, np.nan)
    best_distance = np.where(np.isnan(best[..., 0]), np.inf, _distance(x, corners, best))
    for k in range(3):
        start, end = corners[..., k, :], corners[..., (k + 1) % 3, :]
        length2 = np.einsum("...i,...i", end - start, end - start)
        along = np.einsum("...i,...i", x - start, end - start) / np.where(length2 > 0, length2, 1.0)
        weights = np.zeros(along.shape + (3,))
        weights[..., (k + 1) % 3] = np.clip(along, 0, 1)
        weights[..., k] = 1 - weights[..., (k + 1) % 3]
        distance = _distance(x, corners, weights)
        nearer = distance < best_distance
        best, best_distance = np.where(nearer[..., None], weights, best), np.where(nearer, distance, best_distance)
    return best


def closest(x: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> Closest:
    """The closest points of a mesh, vertices (V, 3) and faces (F, 3), to queries (N, 3)."""
    corners = vertices.astype(np.float64)[faces]
    middle = corners.mean(1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(1)
    parts = []
    for start in range(0, len(x), max(1, _AT_ONCE // (9 * len(faces)))):
        part = x[start : start + max(1, _AT_ONCE // (9 * len(faces)))].astype(np.float64)
        # A triangle is no farther than its middle and no closer than its bounding sphere: only those that can be the closest are tried.
        bound = np.sqrt(sum((part[:, None, k] - middle[None, :, k]) ** 2 for k in range(3)))
        row, triangle = np.nonzero(bound - radius <= bound.min(1, keepdims=True) * (1 + 1e-9) + 1e-9 * radius)
        weights = on_triangles(part[row], corners[triangle])
        distance = _distance(part[row], corners[triangle], weights)
        first = np.lexsort((distance, row))[np.searchsorted(row, np.arange(len(part)))]
        parts.append((triangle[first], weights[first], distance[first]))
    triangle, weights, distance = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return Closest(triangle, weights, np.einsum("nk,nki->ni", weights, corners[triangle]), distance)


def inside(x: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(N,) bool: whether points are inside a closed mesh, by the solid angle that it subtends (van Oosterom and Strackee 1983)."""
    result = []
    for start in range(0, len(x), max(1, _AT_ONCE // (9 * len(faces)))):
        part = x[start : start + max(1, _AT_ONCE // (9 * len(faces)))].astype(np.float64)
        a, b, c = (vertices.astype(np.float64)[faces[:, k]][None] - part[:, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        volume = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
        dots = [np.einsum("nfi,nfi->nf", u, v) for u, v in ((a, b), (b, c), (c, a))]
        result.append(2 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum(1) > 2 * np.pi)
    return np.concatenate(result)


def _distance(x: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    # Relative to each corner, as sums of weighted positions would lose what is far from the origin.
    return np.linalg.norm(np.einsum("...k,...ki->...i", weights, x[..., None, :] - corners), axis=-1)
