"""Whether offsets leave a mesh sound: triangles that have turned over or become slivers, and repairing them."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse

#: A triangle's shape may fall to this, or to this share of what it was, whichever is lower.
MIN_SHAPE = 0.05


def shapes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) 4√3·area / Σ edge²: 1 for an equilateral triangle, 0 for one without area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    squared = sum(((q - p) ** 2).sum(1) for p, q in ((a, b), (b, c), (c, a)))
    return 2 * np.sqrt(3) * np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(squared, 1e-30)


def unsound(rest: np.ndarray, offsets: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) bool: triangles that the offsets turn by more than a right angle, or make slivers (`MIN_SHAPE`).

    Args:
        rest, offsets: (V, 3) metres.
        faces: (F, 3).
    """
    now = rest + offsets
    turned = (_normals(rest, faces) * _normals(now, faces)).sum(1) < 0
    return turned | (shapes(now, faces) < MIN_SHAPE * np.minimum(1, shapes(rest, faces)))


def repair(rest: np.ndarray, offsets: np.ndarray, faces: np.ndarray, sound: np.ndarray | None = None) -> np.ndarray:
    """Offsets, (V, 3), under which no triangle is unsound: around those that are, what they were before.

    The region that goes back grows until nothing is left to repair, which ends, because offsets that were sound everywhere are so
    again at the latest when all have gone back. Averaging with neighbours in place of going back could flatten much of the
    body for the sake of one finger. Intersections of parts of the surface that are far apart along it are not looked for.

    Args:
        rest, offsets: (V, 3) metres.
        faces: (F, 3).
        sound: (V, 3) offsets to go back to, under which no triangle is unsound; none at all by default.
    """
    neighbours = _averaging(faces, len(rest))
    offsets = np.array(offsets, dtype=np.float64, order="C")
    back = np.zeros_like(offsets) if sound is None else sound
    region = np.zeros(len(rest), dtype=bool)
    while (bad := unsound(rest, offsets, faces)).any():
        region[faces[bad]] = True
        region = region | (neighbours @ region > 0)
        if region.all():
            return np.array(back, dtype=np.float64)
        offsets[region] = back[region]
    return offsets


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def _averaging(faces: np.ndarray, count: int) -> sparse.csr_matrix:
    """(V, V) the mean over the neighbours of each vertex."""
    i, j = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    joined = sparse.coo_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), (count, count)).tocsr()
    joined.data[:] = 1
    degree = np.maximum(np.asarray(joined.sum(axis=1)).ravel(), 1)
    return sparse.csr_matrix(sparse.diags(1 / degree) @ joined)
