"""Half-edges of a triangle mesh, and its vertices after some edges are cut.

Half-edge h = 3t + k of triangle t runs from its corner k, which has the same number h, to its corner k + 1.
Arrays over half-edges and over corners are flat, of length 3F.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from ndf_mi.errors import InputError


def following(half_edges: np.ndarray) -> np.ndarray:
    """The next half-edge of the same triangle; as a corner, the end of the half-edge."""
    return half_edges - half_edges % 3 + (half_edges + 1) % 3


def opposites(faces: np.ndarray, where: str = "faces") -> np.ndarray:
    """(3F,) int64: the opposite of each half-edge, -1 on a boundary.

    Raises:
        InputError: a triangle has a vertex twice, more than two triangles share an edge, or two triangles at
            an edge are oriented differently.
    """
    start = faces.ravel().astype(np.int64)
    end = np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    if (start == end).any():
        triangle = int(np.argmax(start == end)) // 3
        raise InputError(where, f"triangle {triangle} with the vertices {faces[triangle].tolist()}",
                         "three different vertices")
    count = int(start.max()) + 1
    key = np.minimum(start, end) * count + np.maximum(start, end)
    _, inverse, shared = np.unique(key, return_inverse=True, return_counts=True)
    if shared.max() > 2:
        edge = int(np.argmax(shared[inverse] > 2))
        found = f"{shared.max()} triangles at the edge of the vertices {start[edge]} and {end[edge]}"
        raise InputError(where, found, "a manifold: at most two triangles at an edge")
    order = np.argsort(inverse, kind="stable")
    first = (np.cumsum(shared) - shared)[shared == 2]
    one, other = order[first], order[first + 1]
    if (start[one] == start[other]).any():
        edge = one[np.argmax(start[one] == start[other])]
        found = f"triangles of different orientation at the edge of vertices {start[edge]} and {end[edge]}"
        raise InputError(where, found, "triangles of one orientation",
                         "Make all triangles counter-clockwise seen from outside.")
    result = np.full(len(start), -1, np.int64)
    result[one], result[other] = other, one
    return result


def vertices_after_cut(opposite: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """(F, 3) int64 vertices of each corner after the half-edges ``cut``, (3F,) bool, are cut open.

    Corners stay one vertex if a fan of triangles joins them across edges that are not cut. Without a cut,
    this splits the vertices where a surface only touches itself.
    """
    inner = np.nonzero((opposite >= 0) & ~cut)[0]
    across = opposite[inner]
    n = len(opposite)
    joined = sparse.coo_matrix((np.ones(len(inner), np.int8), (inner, following(across))), shape=(n, n))
    return csgraph.connected_components(joined, directed=False)[1].astype(np.int64).reshape(-1, 3)


def components(opposite: np.ndarray, cut: np.ndarray | None = None) -> np.ndarray:
    """(F,) the number of each triangle's connected component, across edges that are not ``cut``."""
    inner = np.nonzero(opposite >= 0 if cut is None else (opposite >= 0) & ~cut)[0]
    n = len(opposite) // 3
    joined = sparse.coo_matrix((np.ones(len(inner), np.int8), (inner // 3, opposite[inner] // 3)),
                               shape=(n, n))
    return csgraph.connected_components(joined, directed=False)[1]


def boundary_loops(faces: np.ndarray, opposite: np.ndarray) -> list[np.ndarray]:
    """The vertices of each boundary loop, along its half-edges; every vertex must have one fan."""
    edge = np.nonzero(opposite < 0)[0]
    corners = faces.ravel()
    after = dict(zip(corners[edge].tolist(), corners[following(edge)].tolist(), strict=True))
    loops = []
    while after:
        start, at = after.popitem()
        loop = [start]
        while at != start:
            loop.append(at)
            at = after.pop(at)
        loops.append(np.array(loop))
    return loops


def euler_characteristic(faces: np.ndarray, opposite: np.ndarray) -> int:
    """V - E + F: 2 for a sphere; two less for each handle, one less for each boundary loop."""
    edges = (len(opposite) + int((opposite < 0).sum())) // 2
    return len(np.unique(faces)) - edges + len(faces)


def doubled_areas(corners: np.ndarray) -> np.ndarray:
    """Twice the areas of triangles, (F, 3, 2) or (F, 3, 3); in the plane, signed by orientation."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if corners.shape[2] == 2:
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.linalg.norm(np.cross(a, b), axis=1)
