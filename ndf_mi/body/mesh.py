"""Geometry of triangle meshes that several packages need."""

from __future__ import annotations

import numpy as np


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals: the mean of the normals of adjacent triangles, weighted by their areas.

    The normal is zero where a vertex has no triangle, or where those around it cancel out.

    Args:
        vertices: (V, 3), any unit.
        faces: (F, 3) indices.
    """
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    doubled = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    total = np.stack([np.bincount(faces.ravel(), doubled[:, axis], len(vertices)) for axis in range(3)],
                     axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)
