"""Whether points are inside a closed surface, independent of what the package uses."""

from __future__ import annotations

import numpy as np


def winding_number(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N,): 1 inside and 0 outside, the sum of solid angles (van Oosterom and Strackee 1983).

    Args:
        points: (N, 3).
        triangles: (F, 3, 3) corners.
    """
    a, b, c = (triangles[None, :, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(volume, below).sum(axis=1) / (2 * np.pi)
