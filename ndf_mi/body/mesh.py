"""Geometry and topology of triangle meshes that several packages need, by trimesh.

Registering the plugins imports this module but must not import trimesh, which takes half a second; so the
functions do.
"""

from __future__ import annotations

import numpy as np


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals: the mean of the normals of adjacent triangles, weighted by their areas.

    The normal is zero where a vertex has no triangle, or where those around it cancel out.

    Args:
        vertices: (V, 3), any unit.
        faces: (F, 3) indices.
    """
    import trimesh

    crosses = trimesh.triangles.cross(np.asarray(vertices[faces], np.float64))
    total = trimesh.geometry.index_sparse(len(vertices), faces) @ crosses
    # `mean_vertex_normals` takes sums shorter than 1e-13 for zero.
    return trimesh.util.unitize(total, threshold=0)


def opposite_half_edges(faces: np.ndarray) -> np.ndarray:
    """(3F,) int64: the half-edge of another triangle at the same edge, for each half-edge; -1 on a boundary
    and where more than two triangles share the edge.

    Half-edge 3t + k of triangle t runs from its corner k to its corner k + 1.
    """
    import trimesh

    edges = np.sort(trimesh.geometry.faces_to_edges(faces), axis=1)
    pairs = trimesh.grouping.group_rows(edges, require_count=2)
    opposite = np.full(len(edges), -1)
    opposite[pairs] = pairs[:, ::-1]
    return opposite
