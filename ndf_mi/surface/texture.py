"""Textures of a mesh: splitting vertices at seams, and filling texels that no image has seen."""

from __future__ import annotations

import numpy as np


def split_seams(faces: np.ndarray, uv: np.ndarray,
                uv_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gives every vertex one pair of texture coordinates, by doubling those that lie on a seam.

    Args:
        faces: (F, 3) indices of vertices.
        uv: (U, 2) texture coordinates.
        uv_faces: (F, 3) indices into `uv`, corner by corner with `faces`.

    Returns:
        source (N,), the vertex that each new vertex copies; faces (F, 3) over the new vertices; uv (N, 2).
    """
    corners = np.stack([faces.ravel(), uv_faces.ravel()], axis=1).astype(np.int64)
    pairs, inverse = np.unique(corners, axis=0, return_inverse=True)
    return pairs[:, 0], inverse.reshape(faces.shape).astype(np.uint32), uv[pairs[:, 1]].astype(np.float32)


def fill_unseen(texture: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Fills the texels that were not seen from their seen neighbours by push-pull (Gortler et al. 1996,
    section 4.2).

    Seen texels are averaged into ever coarser levels, and each hole takes the finest level that knows
    something there, bilinearly enlarged. Seen texels keep their values. Without a seen texel, the texture
    comes back unchanged.

    Args:
        texture: (h, w, c).
        seen: (h, w) bool.
    """
    weight = seen.astype(np.float64)
    if not seen.any():
        return texture.copy()
    return _push_pull(texture.astype(np.float64), weight).astype(texture.dtype)


def _push_pull(values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    if weight.all() or max(weight.shape) == 1:
        return values
    height, width = weight.shape
    even = ((0, height % 2), (0, width % 2))
    blocks = np.pad(weight, even).reshape((height + 1) // 2, 2, (width + 1) // 2, 2)
    sums = np.pad(values * weight[..., None], (*even, (0, 0))).reshape(*blocks.shape, -1).sum(axis=(1, 3))
    total = blocks.sum(axis=(1, 3))
    known = total > 0
    means = np.where(known[..., None], sums / np.where(known, total, 1)[..., None], 0)
    coarse = _push_pull(means, known.astype(float))
    return np.where(weight[..., None] > 0, values, _enlarge(coarse, height, width))


def _enlarge(values: np.ndarray, height: int, width: int) -> np.ndarray:
    """Bilinear enlargement of (h, w, c) by two, cut to (height, width)."""
    for axis, size in ((0, height), (1, width)):
        position = np.clip((np.arange(size) + 0.5) / 2 - 0.5, 0, values.shape[axis] - 1)
        low = position.astype(int)
        high = np.minimum(low + 1, values.shape[axis] - 1)
        share = (position - low).reshape([-1 if a == axis else 1 for a in range(3)])
        values = values.take(low, axis) * (1 - share) + values.take(high, axis) * share
    return values
