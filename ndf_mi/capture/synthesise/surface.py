"""Operations on triangle meshes that are linear in the vertices: subdivision, clipping and smoothing."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy import sparse
from scipy.spatial import cKDTree


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undirected edges (E, 2) of (F, 3) faces, and (F, 3) indices of each face's edges 01, 12, 20."""
    edges = np.sort(trimesh.geometry.faces_to_edges(faces), axis=1)
    first, index = trimesh.grouping.unique_rows(edges[:, ::-1])  # in the order of the first column
    return edges[first], index.reshape(-1, 3)


def loop_subdivision(faces: np.ndarray, count: int) -> tuple[sparse.csr_matrix, np.ndarray]:
    """One step of Loop subdivision (Loop 1987, Warren's weights) of a mesh of ``count`` vertices.

    Returns:
        The (count + E, count) matrix from old vertices (or their attributes) to new ones, and the (4 F, 3)
        faces over these. Boundaries become cubic B-splines.
    """
    edges, face_edges = edges_of(faces)
    new = np.arange(len(edges))
    sides = np.bincount(face_edges.ravel(), minlength=len(edges))
    inner = sides == 2

    # Edge points: 3/8 of the ends and 1/8 of the opposite corners; halfway on a boundary.
    opposite = faces[:, [2, 0, 1]].ravel()
    weight = np.where(inner, 3 / 8, 1 / 2)
    on_inner = inner[face_edges.ravel()]
    rows = np.concatenate([new, new, face_edges.ravel()[on_inner]])
    columns = np.concatenate([edges[:, 0], edges[:, 1], opposite[on_inner]])
    values = np.concatenate([weight, weight, np.full(on_inner.sum(), 1 / 8)])
    odd = sparse.csr_matrix((values, (rows, columns)), shape=(len(edges), count))

    # Old vertices: 1 - n·β and β for each of n neighbours; 3/4 and 1/8 along a boundary.
    boundary = np.zeros(count, dtype=bool)
    boundary[edges[~inner]] = True
    both = np.concatenate([edges, edges[:, ::-1]])
    kept = np.where(boundary[both[:, 0]], ~np.concatenate([inner, inner]), True)
    both = both[kept]
    valence = np.maximum(np.bincount(both[:, 0], minlength=count), 1)
    beta = np.where(boundary, 1 / 8, np.where(valence == 3, 3 / 16, 3 / (8 * valence)))
    even = sparse.csr_matrix((beta[both[:, 0]], (both[:, 0], both[:, 1])), shape=(count, count))
    used = np.bincount(both[:, 0], minlength=count)
    even = even + sparse.diags(1 - used * beta)

    middle = face_edges + count
    a, b, c = faces.T
    ab, bc, ca = middle.T
    split = np.stack([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]).transpose(2, 0, 1).reshape(-1, 3)
    return sparse.vstack([even, odd], format="csr"), split


def clip(faces: np.ndarray, values: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Keeps the part of a mesh where ``values``, (V,), interpolated linearly, are positive.

    Returns:
        The (V', V) matrix from old vertices or their attributes to new ones, and the (F', 3) faces over
        these.
    """
    count = len(values)
    edges, face_edges = edges_of(faces)
    inside = values > 0
    crossing = inside[edges[:, 0]] != inside[edges[:, 1]]
    cut = edges[crossing]
    first, second = values[cut[:, 0]], values[cut[:, 1]]
    t = first / np.where(first == second, 1, first - second)
    number = np.full(len(edges), -1)
    number[crossing] = count + np.arange(len(cut))
    rows = np.arange(len(cut))
    at_cut = sparse.csr_matrix(
        (np.concatenate([1 - t, t]), (np.concatenate([rows, rows]), cut.T.ravel())), shape=(len(cut), count)
    )

    kept = [faces[inside[faces].all(axis=1)]]
    for corner in range(3):
        order = [corner, (corner + 1) % 3, (corner + 2) % 3]
        a, b, c = faces[:, order].T
        ab, bc, ca = number[face_edges[:, order]].T
        alone = inside[a] & ~inside[b] & ~inside[c]
        kept.append(np.stack([a, ab, ca], axis=1)[alone])
        pair = ~inside[a] & inside[b] & inside[c]
        kept.append(np.stack([ab, b, c], axis=1)[pair])
        kept.append(np.stack([ab, c, ca], axis=1)[pair])
    cut_faces = np.concatenate(kept)
    used, renumbered = np.unique(cut_faces, return_inverse=True)
    matrix = sparse.vstack([sparse.eye(count, format="csr"), at_cut], format="csr")[used]
    return matrix, renumbered.reshape(-1, 3)


def rim_distance(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) distance in metres to the nearest vertex of the boundary; infinite for a closed mesh."""
    edges = np.sort(trimesh.geometry.faces_to_edges(faces), axis=1)
    rim = np.unique(edges[trimesh.grouping.group_rows(edges, require_count=1)])
    return cKDTree(vertices[rim]).query(vertices)[0] if len(rim) else np.full(len(vertices), np.inf)


def averaging(faces: np.ndarray, count: int) -> sparse.csr_matrix:
    """(V, V) matrix that replaces a vertex by the mean of itself and its neighbours' mean."""
    edges, _ = edges_of(faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    valence = np.bincount(both[:, 0], minlength=count)
    share = np.where(valence > 0, 0.5 / np.maximum(valence, 1), 0)
    neighbours = sparse.csr_matrix((share[both[:, 0]], (both[:, 0], both[:, 1])), shape=(count, count))
    return (neighbours + sparse.diags(np.where(valence > 0, 0.5, 1.0))).tocsr()
