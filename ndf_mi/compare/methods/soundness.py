"""Whether offsets leave a mesh sound: triangles that have turned over or become slivers, and mending them."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse

#: A triangle's shape may fall to this, or to this share of what it was, whichever is lower.
MIN_SHAPE = 0.05
#: Rings of neighbours around what is unsound grow after so many rounds of smoothing.
_ROUNDS_A_RING = 4


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


def mend(rest: np.ndarray, offsets: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Offsets, (V, 3), under which no triangle is unsound: averaged with their neighbours around those that are.

    The region that is smoothed grows until nothing is left to mend, which ends, because equal offsets turn nothing.
    Intersections of parts of the surface that are far apart along it are not looked for.
    """
    neighbours = _averaging(faces, len(rest))
    offsets = np.array(offsets, dtype=np.float64, order="C")
    region = np.zeros(len(rest), dtype=bool)
    rounds = 0
    while (bad := unsound(rest, offsets, faces)).any():
        region[faces[bad]] = True
        if rounds % _ROUNDS_A_RING == 0:
            region = region | (neighbours @ region > 0)
        offsets[region] = (0.5 * offsets + 0.5 * (neighbours @ offsets))[region]
        rounds += 1
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
