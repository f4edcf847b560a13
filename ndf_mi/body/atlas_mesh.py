"""Half-edges of a triangle mesh, and its vertices after some edges are cut.

Half-edge h = 3t + k of triangle t runs from its corner k, which has the same number h, to its corner k + 1.
Arrays over half-edges and over corners are flat, of length 3F.
"""

from __future__ import annotations

import numpy as np
import trimesh

from ndf_mi.body.mesh import opposite_half_edges
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
    start, end = trimesh.geometry.faces_to_edges(faces).T
    if (start == end).any():
        triangle = int(np.argmax(start == end)) // 3
        raise InputError(where, f"triangle {triangle} with the vertices {faces[triangle].tolist()}",
                         "three different vertices")
    opposite = opposite_half_edges(faces)
    single = np.nonzero(opposite < 0)[0]
    edges = np.sort(np.stack([start, end], axis=1)[single], axis=1)
    first, inverse = trimesh.grouping.unique_rows(edges)
    shared = np.bincount(inverse)
    if len(first) < len(single):
        edge = edges[first[np.argmax(shared)]]
        found = f"{shared.max()} triangles at the edge of the vertices {edge[0]} and {edge[1]}"
        raise InputError(where, found, "a manifold: at most two triangles at an edge")
    turned = (opposite >= 0) & (start == start[opposite])
    if turned.any():
        edge = int(np.argmax(turned))
        found = f"triangles of different orientation at the edge of vertices {start[edge]} and {end[edge]}"
        raise InputError(where, found, "triangles of one orientation",
                         "Make all triangles counter-clockwise seen from outside.")
    return opposite


def vertices_after_cut(opposite: np.ndarray, cut: np.ndarray) -> np.ndarray:
    """(F, 3) int64 vertices of each corner after the half-edges ``cut``, (3F,) bool, are cut open.

    Corners stay one vertex if a fan of triangles joins them across edges that are not cut. Without a cut,
    this splits the vertices where a surface only touches itself.
    """
    inner = np.nonzero((opposite >= 0) & ~cut)[0]
    joined = np.stack([inner, following(opposite[inner])], axis=1)
    labels = trimesh.graph.connected_component_labels(joined, node_count=len(opposite))
    return labels.astype(np.int64).reshape(-1, 3)


def components(opposite: np.ndarray, cut: np.ndarray | None = None) -> np.ndarray:
    """(F,) the number of each triangle's connected component, across edges that are not ``cut``."""
    inner = np.nonzero(opposite >= 0 if cut is None else (opposite >= 0) & ~cut)[0]
    joined = np.stack([inner, opposite[inner]], axis=1) // 3
    return trimesh.graph.connected_component_labels(joined, node_count=len(opposite) // 3)


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
