"""Degenerate triangles that vertex offsets make, turned over or without area, and their repair."""

from __future__ import annotations

import numpy as np
import trimesh

MIN_QUALITY = 0.05
"""Smallest quality of a triangle, or smallest share of its quality at rest, whichever is lower."""


def triangle_quality(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) 4√3·area / Σ edge²: 1 for an equilateral triangle, 0 for one without area.

    Args:
        vertices: (V, 3).
        faces: (F, 3).
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    squared = sum(((q - p) ** 2).sum(1) for p, q in ((a, b), (b, c), (c, a)))
    return 4 * np.sqrt(3) * trimesh.triangles.area(vertices[faces]) / np.maximum(squared, 1e-30)


def degenerate_triangles(rest: np.ndarray, offsets: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) bool: triangles that the offsets turn by more than a right angle, or whose quality they make too
    low.

    Args:
        rest, offsets: (V, 3) metres.
        faces: (F, 3).
    """
    moved = rest + offsets
    turned = (trimesh.triangles.cross(rest[faces]) * trimesh.triangles.cross(moved[faces])).sum(1) < 0
    least = MIN_QUALITY * np.minimum(1, triangle_quality(rest, faces))
    return turned | (triangle_quality(moved, faces) < least)


def repair(rest: np.ndarray, offsets: np.ndarray, faces: np.ndarray,
           known: np.ndarray | None = None) -> np.ndarray:
    """(V, 3) float64 offsets without degenerate triangles: around these, the offsets return to known ones.

    The region that returns grows until no triangle is degenerate. That ends: at the latest, all offsets have
    returned. Smoothing would not do instead, because it could flatten much of the body for the sake of one
    finger. Intersections of parts of the surface that are far apart along it are not found.

    Args:
        rest, offsets: (V, 3) metres.
        faces: (F, 3).
        known: (V, 3) offsets that make no triangle degenerate; zero by default.
    """
    offsets = np.array(offsets, dtype=np.float64, order="C")
    back = np.zeros_like(offsets) if known is None else known
    region = np.zeros(len(rest), dtype=bool)
    while (bad := degenerate_triangles(rest, offsets, faces)).any():
        region[faces[bad]] = True
        region[faces[region[faces].any(axis=1)]] = True
        if region.all():
            return np.array(back, dtype=np.float64)
        offsets[region] = back[region]
    return offsets
