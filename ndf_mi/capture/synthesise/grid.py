"""Triangles of grids that are wrapped around an axis."""

from __future__ import annotations

import numpy as np


def grid_faces(rows: int, columns: int, closed: bool = True, capped: bool = True) -> np.ndarray:
    """Outward triangles of a grid of vertices, row by row from the top down, each row to the left.

    Args:
        closed: whether the last column is joined to the first.
        capped: whether the first row is closed by a fan.
    """
    first = np.arange(columns if closed else columns - 1)
    a = np.arange(rows - 1)[:, None] * columns + first
    b = np.arange(rows - 1)[:, None] * columns + (first + 1) % columns
    quads = np.concatenate([np.stack([a, a + columns, b], axis=-1),
                            np.stack([b, a + columns, b + columns], axis=-1)])
    if not capped:
        return quads.reshape(-1, 3)
    ring = np.arange(1, columns - 1)
    return np.concatenate([quads.reshape(-1, 3), np.stack([0 * ring, ring, ring + 1], axis=-1)])


def sphere(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit directions (N, 3) of a grid around the y axis, from the top down, without the poles.

    Returns:
        The directions; (N,) angles around the axis, 0 along +z and growing towards +x; and (N,) elevations,
        in radians.
    """
    around = np.arange(columns) / columns * 2 * np.pi
    elevation = np.pi / 2 * np.linspace(0.995, -0.995, rows)
    phi, up = (grid.ravel() for grid in np.meshgrid(around, elevation))
    return np.stack([np.sin(phi) * np.cos(up), np.sin(up), np.cos(phi) * np.cos(up)], axis=-1), phi, up
