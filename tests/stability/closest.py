"""Closest points on triangle meshes in float64, by trying every triangle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

_AT_ONCE = 1 << 21


@dataclass(frozen=True)
class Closest:
    """The closest points to N queries: `triangle`, `weights` of its corners (N, 3), and `distance`."""

    triangle: np.ndarray
    weights: np.ndarray
    distance: np.ndarray


def on_triangles(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N, 3) weights of the closest points to x (N, 3) on triangles (N, 3, 3).

    It is the foot of the perpendicular onto the plane if that is inside, otherwise the nearest point of the
    three edges.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    square = _dot(normal, normal)
    flat = square <= 1e-32 * _dot(b - a, b - a) * _dot(c - a, c - a)
    safe = np.where(flat, 1.0, square)
    areas = [_dot(np.cross(end - start, x - start), normal) / safe for start, end in ((b, c), (c, a), (a, b))]
    best = np.stack(areas, -1)
    best_distance = np.where((best >= 0).all(-1) & ~flat, _distance(x, corners, best), np.inf)
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        length2 = _dot(end - start, end - start)
        weights = np.zeros(x.shape)
        weights[:, (k + 1) % 3] = np.clip(
            _dot(x - start, end - start) / np.where(length2 > 0, length2, 1.0), 0, 1)
        weights[:, k] = 1 - weights[:, (k + 1) % 3]
        distance = _distance(x, corners, weights)
        nearer = distance < best_distance
        best, best_distance = (
            np.where(nearer[:, None], weights, best), np.where(nearer, distance, best_distance))
    return best


def closest(x: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> Closest:
    """The closest points of a mesh, vertices (V, 3) and faces (F, 3), to queries (N, 3)."""
    corners = vertices.astype(np.float64)[faces]
    middle = corners.mean(1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(1)
    results = []
    for part in _parts(x, len(faces)):
        # A triangle is at most as far as its middle and at least as far as its bounding sphere. The others
        # cannot be the closest.
        bound = np.sqrt(sum((part[:, None, k] - middle[None, :, k]) ** 2 for k in range(3)))
        row, triangle = np.nonzero(bound - radius <= bound.min(1, keepdims=True) * (1 + 1e-9) + 1e-9 * radius)
        weights = on_triangles(part[row], corners[triangle])
        distance = _distance(part[row], corners[triangle], weights)
        first = np.lexsort((distance, row))[np.searchsorted(row, np.arange(len(part)))]
        results.append((triangle[first], weights[first], distance[first]))
    return Closest(*(np.concatenate(columns) for columns in zip(*results, strict=True)))


def inside(x: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(N,) bool: whether points are inside a closed mesh, by the solid angle that it subtends (van Oosterom
    and Strackee 1983)."""
    result = []
    for part in _parts(x, len(faces)):
        a, b, c = (vertices.astype(np.float64)[faces[:, k]][None] - part[:, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        volume = _dot(a, np.cross(b, c))
        below = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
        result.append(2 * np.arctan2(volume, below).sum(1) > 2 * np.pi)
    return np.concatenate(result)


def _parts(x: np.ndarray, faces: int) -> Iterator[np.ndarray]:
    """Queries in float64, few enough at a time for arrays of queries times faces."""
    count = max(1, _AT_ONCE // (9 * faces))
    for start in range(0, len(x), count):
        yield x[start : start + count].astype(np.float64)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i", a, b)


def _distance(x: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    # Relative to each corner: sums of weighted positions would lose digits far from the origin.
    return np.linalg.norm(np.einsum("nk,nki->ni", weights, x[:, None] - corners), axis=-1)
