"""The search tree of a mesh: topology that no pose changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndf_mi.body.mesh import opposite_half_edges


@dataclass(frozen=True)
class Tree:
    """A complete binary tree over pairs of adjacent triangles, in heap order (root 1, children 2n and 2n +
    1).

    Leaf slot ``i`` is node ``leaves + i``. A slot past the number of pairs repeats another pair and is not
    ``occupied``.

    Attributes:
        depth: levels below the root; there are ``2 ** depth`` leaves, and at least one level.
        corners: (leaves, 4) uint32, vertices a, b, c, d of the two triangles (a, b, c) and (a, c, d); a
            triangle without a partner has d = c.
        triangles: (leaves, 2) uint32, the mesh's triangles that these are; the same one twice without a
            partner.
        occupied: (leaves,) bool.
    """

    depth: int
    corners: np.ndarray
    triangles: np.ndarray
    occupied: np.ndarray


def pair_triangles(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joins triangles across shared edges, the edge that is longest for its two triangles first.

    Two triangles of a pair share two vertices, so that a leaf reads four vertices for two triangles.

    Returns:
        (P, 4) corners and (P, 2) triangles, as in :class:`Tree`.
    """
    opposite = opposite_half_edges(faces).reshape(faces.shape)
    corner = vertices[faces]
    length = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2)
    share = length / np.maximum(length.sum(1, keepdims=True), np.finfo(np.float64).tiny)
    t, k = np.nonzero(opposite // 3 > np.arange(len(faces))[:, None])
    n, m = np.divmod(opposite[t, k], 3)
    order = np.argsort(-(share[t, k] + share[n, m]), kind="stable")
    free = np.ones(len(faces), bool)
    chosen = []
    for i in order.tolist():
        if free[t[i]] and free[n[i]]:
            free[t[i]] = free[n[i]] = False
            chosen.append(i)
    single = np.nonzero(free)[0]
    t, k, n, m = (np.asarray(part[chosen], np.int64) for part in (t, k, n, m))
    # Edge k of t runs from c to a: the diagonal that both triangles share.
    columns = [faces[t, (k + 1) % 3], faces[t, (k + 2) % 3], faces[t, k], faces[n, (m + 2) % 3]]
    alone = faces[single][:, [0, 1, 2, 2]]
    corners = np.concatenate([np.stack(columns, axis=1), alone])
    triangles = np.concatenate([np.stack([t, n], axis=1), np.stack([single, single], axis=1)])
    return corners.astype(np.uint32), triangles.astype(np.uint32)


def build_tree(vertices: np.ndarray, faces: np.ndarray) -> Tree:
    """A balanced tree of the pairs, split at the median along the longest side of the boxes of their
    centres."""
    corners, triangles = pair_triangles(vertices, faces)
    count = len(corners)
    depth = max(1, int(np.ceil(np.log2(count))))
    points = vertices[corners]
    centre = 0.5 * (points.min(1) + points.max(1))
    order = np.arange(count)
    for level in range(depth):
        bounds = (np.arange((1 << level) + 1) * count) >> level
        segment = np.repeat(np.arange(1 << level), np.diff(bounds))
        begin = np.minimum(bounds[:-1], count - 1)
        at = centre[order]
        side = np.maximum.reduceat(at, begin) - np.minimum.reduceat(at, begin)
        axis = np.argmax(side, axis=1)[segment]
        order = order[np.lexsort((at[np.arange(count), axis], segment))]
    bounds = (np.arange((1 << depth) + 1) * count) >> depth
    slot = order[np.minimum(bounds[:-1], count - 1)]
    return Tree(depth, corners[slot], triangles[slot], np.diff(bounds) > 0)
