"""Chooses the seam along which a surface is cut into a disk that can be flattened.

The seam starts as a tree of shortest paths between the boundary loops, with loops that open every handle;
these come from the tree and the remaining edges of its cotree (Erickson and Whittlesey, "Greedy optimal
homotopy and homology generators", SODA 2005). It then grows to every region that a harmonic map of the cut
surface onto a disk squeezes: hands, fingers, feet, head. Gu, Gortler and Hoppe ("Geometry images", SIGGRAPH
2002) grow a cut to where the map is stretched most. Paths prefer edges that are visible from few directions,
face away from the front, and are long.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy import sparse
from scipy.sparse import csgraph

from ndf_mi.body import atlas_mesh as mesh
from ndf_mi.body.atlas_flatten import harmonic_disk
from ndf_mi.body.mesh import vertex_normals

SQUEEZED = 1e-4
"""The seam must reach a vertex whose area shrinks by more than this in a harmonic map onto the disk.

A tube of length L and radius r shrinks by about exp(-2L/r): limbs longer than about 4.6 radii are reached."""

LEAST_PERIMETER = 0.5
"""The least perimeter of a chart, relative to that of a flat disk of its area. A shorter one grows, such as
that of a ball with a small hole."""

HIDDEN = 0.15
"""A squeezed vertex must be visible from this fraction of directions; mouths may stay small."""

_ROUNDS = 16
_DIRECTIONS = 64
_OPEN_COST = 10.0
_FRONT_COST = 10.0


def choose_seam(points: np.ndarray, faces: np.ndarray, opposite: np.ndarray, front: np.ndarray) -> np.ndarray:
    """The half-edges, (3F,) bool, that open one connected surface into a disk.

    Args:
        points: (V, 3) float64.
        faces: (F, 3), connected; every vertex has one fan of triangles.
        opposite: its half-edges' opposites, from `atlas_mesh.opposites`.
        front: (3,) unit vector; paths prefer vertices that face away from it.
    """
    seam = _Seam(points, faces, opposite, front)
    loops = mesh.boundary_loops(faces, opposite)
    genus = (2 - len(loops) - trimesh.Trimesh(points, faces, process=False).euler_number) // 2
    if loops:
        seam.start(loops[0])
        seam.extend(loops[1:])
    elif genus:
        seam.start(np.array([seam.farthest(np.array([0]))]))
    else:
        first = seam.farthest(np.array([0]))
        second = seam.farthest(np.array([first]))
        third = seam.farthest(np.array([first, second]))
        seam.start(np.array([first]))
        seam.extend([np.array([second]), np.array([third])])
    if genus:
        seam.open_handles()
    area = trimesh.triangles.area(points[faces]).sum()
    while seam.perimeter < LEAST_PERIMETER * np.sqrt(4 * np.pi * area) and not seam.reached.all():
        seam.extend([np.array([seam.farthest(np.nonzero(seam.reached)[0])])])
    for _ in range(_ROUNDS):
        tips = _squeezed_tips(points, faces, opposite, seam)
        if not tips:
            break
        seam.extend(tips)
    return seam.cut


class _Seam:
    """A growing seam: its vertices, its half-edges, and shortest paths to it."""

    def __init__(
        self, points: np.ndarray, faces: np.ndarray, opposite: np.ndarray, front: np.ndarray
    ) -> None:
        self._opposite = opposite
        self.cut = np.zeros(len(opposite), bool)
        self.reached = np.zeros(len(points), bool)
        self._h = np.nonzero(opposite < np.arange(len(opposite)))[0]  # one half-edge an edge
        corners = faces.ravel()
        self._u, self._v = corners[self._h], corners[mesh.following(self._h)]
        length = np.linalg.norm(points[self._u] - points[self._v], axis=1)
        length = np.maximum(length, 1e-6 * length.mean())  # without steps of no length, which would tie paths
        self.seen = openness(points, faces)
        facing = np.maximum(vertex_normals(points, faces) @ front, 0)
        factor = 1 + _OPEN_COST * self.seen + _FRONT_COST * facing
        # Meshes are fine in the face, where a seam shows: each step costs more than its length.
        self._cost = (length + length.mean()) * (factor[self._u] + factor[self._v]) / 2
        self._length = length
        self._lengths, self._costs = self._graph(length), self._graph(self._cost)
        self._edge = {pair: i for i, pair in enumerate(zip(self._u.tolist(), self._v.tolist(), strict=True))}

    def _graph(self, weights: np.ndarray) -> sparse.csr_matrix:
        count = len(self.reached)
        both = (np.r_[self._u, self._v], np.r_[self._v, self._u])
        return sparse.csr_matrix((np.r_[weights, weights], both), shape=(count, count))

    def distances(self, sources: np.ndarray) -> np.ndarray:
        """(V,) lengths of shortest paths along edges from the nearest of some vertices."""
        return csgraph.dijkstra(self._lengths, indices=sources, min_only=True)

    def farthest(self, sources: np.ndarray) -> int:
        return int(np.argmax(self.distances(sources)))

    @property
    def perimeter(self) -> float:
        """The length of the boundary after cutting: both sides of the seam count."""
        sides = 2.0 * self.cut[self._h] + (self._opposite[self._h] < 0)
        return float(sides @ self._length)

    def start(self, vertices: np.ndarray) -> None:
        self.reached[vertices] = True

    def extend(self, targets: list[np.ndarray]) -> None:
        """Joins sets of vertices to the seam, the nearest first; a path ends where it first meets a set."""
        targets = list(targets)
        while targets:
            far, before = self._paths()
            nearest = min(range(len(targets)), key=lambda i: far[targets[i]].min())
            target = targets.pop(nearest)
            if not self.reached[target].any():
                self._walk(int(target[np.argmin(far[target])]), before)
            self.reached[target] = True

    def _paths(self) -> tuple[np.ndarray, np.ndarray]:
        sources = np.nonzero(self.reached)[0]
        far, before, _ = csgraph.dijkstra(self._costs, indices=sources, min_only=True,
                                          return_predecessors=True)
        return far, before

    def _walk(self, vertex: int, before: np.ndarray) -> None:
        self.reached[vertex] = True
        while before[vertex] >= 0:
            onto = int(before[vertex])
            self._open(self._number(vertex, onto))
            vertex = onto
            self.reached[vertex] = True

    def _number(self, a: int, b: int) -> int:
        return self._edge[a, b] if (a, b) in self._edge else self._edge[b, a]

    def _open(self, edge: int) -> None:
        h = self._h[edge]
        self.cut[[h, self._opposite[h]]] = True

    def open_handles(self) -> None:
        """Adds the 2g loops of a tree-cotree decomposition: edges in neither tree, with their paths."""
        far, before = self._paths()
        tree = np.zeros(len(self._h), bool)
        for vertex in np.nonzero(before >= 0)[0].tolist():
            tree[self._number(vertex, int(before[vertex]))] = True
        across = self._opposite[self._h]
        crossed = np.nonzero(~tree & (across >= 0) & ~self.cut[self._h])[0]
        loop = far[self._u] + self._cost + far[self._v]
        # Kruskal's algorithm by rank, longest loops first: ranks differ, so that the tree is unique and its
        # edges are known.
        crossed = crossed[np.argsort(-loop[crossed], kind="stable")]
        one, other = self._h[crossed] // 3, across[crossed] // 3
        pairs = np.sort(np.stack([one, other], 1), axis=1)
        _, first = np.unique(pairs, axis=0, return_index=True)
        count = len(self.cut) // 3
        dual = sparse.coo_matrix((first + 1.0, (pairs[first, 0], pairs[first, 1])), shape=(count, count))
        kept = csgraph.minimum_spanning_tree(dual.tocsr()).data.astype(np.int64) - 1
        for edge in np.delete(crossed, kept).tolist():
            self._walk(int(self._u[edge]), before)
            self._walk(int(self._v[edge]), before)
            self._open(edge)


def _squeezed_tips(
    points: np.ndarray, faces: np.ndarray, opposite: np.ndarray, seam: _Seam
) -> list[np.ndarray]:
    """The vertex farthest from the seam in every region that a harmonic map of the cut surface squeezes."""
    split = mesh.vertices_after_cut(opposite, seam.cut)
    source = np.zeros(split.max() + 1, np.int64)
    source[split.ravel()] = faces.ravel()
    flat = harmonic_disk(points[source], split)
    found, true = trimesh.triangles.cross(flat[split]), trimesh.triangles.area(points[faces])
    around = [np.bincount(faces.ravel(), np.repeat(a / a.sum(), 3), len(points)) for a in (found, true)]
    squeezed = ~(around[0] > SQUEEZED * around[1]) & ~seam.reached & (seam.seen > HIDDEN)
    edges = trimesh.geometry.faces_to_edges(faces)
    inner = edges[squeezed[edges].all(axis=1)]
    regions = trimesh.graph.connected_component_labels(inner, node_count=len(points))
    far = np.where(squeezed, seam.distances(np.nonzero(seam.reached)[0]), -1.0)
    tips: dict[int, int] = {}
    for vertex in np.nonzero(squeezed)[0].tolist():
        best = tips.setdefault(int(regions[vertex]), vertex)
        if far[vertex] > far[best]:
            tips[int(regions[vertex])] = vertex
    return [np.array([vertex]) for vertex in tips.values()]


def openness(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) the fraction of 64 directions from which each vertex is visible, in [0, 0.5].

    This is an estimate: a vertex counts as hidden if the surface in its cell, a mean edge wide, is more than
    a cell nearer. Slanting views are lost, so that a ball gets about 0.3.
    """
    corners = points[faces]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    samples = np.concatenate([points, middles.reshape(-1, 3), corners.mean(1)])
    cell = 2 * float(np.linalg.norm(middles - corners, axis=2).mean())
    normals = vertex_normals(points, faces)
    k = np.arange(_DIRECTIONS) + 0.5
    height, turn = 1 - 2 * k / _DIRECTIONS, k * np.pi * (1 + 5**0.5)  # Fibonacci's sphere
    ring = np.sqrt(1 - height**2)
    seen = np.zeros(len(points))
    for towards in np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1):
        side = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
        side /= np.linalg.norm(side)
        plane = samples @ np.stack([side, np.cross(towards, side)], axis=1)
        cells = ((plane - plane.min(0)) / cell).astype(np.int64)
        _, at = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)
        depth = samples @ towards
        nearest = np.full(at.max() + 1, -np.inf)
        np.maximum.at(nearest, at, depth)
        count = len(points)
        seen += (normals @ towards > 0) & (depth[:count] > nearest[at[:count]] - cell)
    return seen / _DIRECTIONS
