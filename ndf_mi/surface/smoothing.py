"""Smoothing on a triangle mesh by a length in metres: the preconditioner that keeps offsets under
optimisation smooth.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import trimesh
from scipy.sparse.linalg import splu

_WEIGHTS = (0.05, 20.0)
"""Limits of cotangent weights: with them, slivers and obtuse triangles leave the operator positive and
connected.
"""


def cotangent_stiffness(vertices: np.ndarray, faces: np.ndarray) -> sparse.csc_matrix:
    """The stiffness matrix C of linear finite elements, (V, V): xᵀCx = ∫ |∇x|², entries -(cot α + cot β)/2
    off the diagonal.

    The weight of each edge is clipped to [0.05, 20]. Rows sum to zero.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3).
    """
    rows, columns, values = [], [], []
    for corner in range(3):
        i, j, k = (faces[:, (corner + turn) % 3].astype(np.int64) for turn in range(3))
        a, b = vertices[j] - vertices[i], vertices[k] - vertices[i]
        doubled = np.linalg.norm(np.cross(a, b), axis=1)
        rows.append(np.minimum(j, k))
        columns.append(np.maximum(j, k))
        values.append(0.5 * (a * b).sum(1) / np.maximum(doubled, 1e-12))
    count = len(vertices)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    upper = sparse.coo_matrix(entries, (count, count))
    upper.sum_duplicates()
    upper.data = np.clip(upper.data, *_WEIGHTS)
    weights = upper + upper.T
    return sparse.csc_matrix(sparse.diags(np.asarray(weights.sum(axis=1)).ravel()) - weights)


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) a third of the area of the triangles around each vertex, m², at least a millionth of the mean."""
    areas = trimesh.geometry.index_sparse(len(vertices), faces) @ trimesh.triangles.area(vertices[faces]) / 3
    return np.maximum(areas, 1e-6 * areas.mean())


class SmoothOffsets:
    """Offsets d of a mesh's vertices, optimised through a latent u that is smoothed by a length h:

        d = (M + h² C)⁻¹ M u,

    with the vertices' areas M and the cotangent stiffness C. This is the preconditioning of Nicolet et al.
    (2021, "Large Steps in Inverse Rendering of Geometry") with the Laplacian of finite elements in place of
    the combinatorial one. The latter smooths over a number of edges, and a body's edges are between less than
    a millimetre and centimetres long. Steps are those of their AdamUniform: Adam with one second moment for
    all, the largest, which keeps a step as smooth as its gradient.

    Args:
        vertices: (V, 3) the mesh at rest, metres; lengths and areas are measured on it.
        faces: (F, 3).

    Attributes:
        offsets: (V, 3) float64, metres; zero at first.
    """

    BETAS = (0.9, 0.999)

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._areas = vertex_areas(vertices.astype(np.float64), faces)
        self._stiffness = cotangent_stiffness(vertices.astype(np.float64), faces)
        self._length = 0.0
        self.offsets = np.zeros((len(vertices), 3))
        self.set_length(0.1)

    def set_length(self, length: float) -> None:
        """Sets h, metres, from the next step on. The offsets stay; the moments, which belong to the old u,
        start again.
        """
        if length != self._length:
            self._length = length
            self._matrix = sparse.csc_matrix(sparse.diags(self._areas) + length**2 * self._stiffness)
            self._factors = splu(self._matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
            self.replace(self.offsets)
            self._first = np.zeros_like(self.offsets)
            self._second = np.zeros_like(self.offsets)
            self._steps = 0

    def replace(self, offsets: np.ndarray) -> None:
        """Sets the offsets, (V, 3) metres; u follows, the moments stay."""
        self.offsets = np.array(offsets, dtype=np.float64)
        self._latent = self._matrix @ self.offsets / self._areas[:, None]

    def strain(self) -> tuple[float, np.ndarray]:
        """∫ |∇d|² over the mesh divided by its area, and its gradient in the offsets, (V, 3) 1/m."""
        gradient = self._stiffness @ self.offsets / self._areas.sum()
        return float((self.offsets * gradient).sum()), 2 * gradient

    def step(self, gradient: np.ndarray, rate: float) -> None:
        """Takes one step of AdamUniform: no component of u moves by more than about `rate`.

        Args:
            gradient: (V, 3) of the loss in the offsets.
            rate: metres.
        """
        # The gradient of u as a function on the surface, M⁻¹ (∂d/∂u)ᵀ g, is independent of the triangulation.
        latent = self._factors.solve(np.ascontiguousarray(gradient, dtype=np.float64))
        first, second = self.BETAS
        self._steps += 1
        self._first += (1 - first) * (latent - self._first)
        self._second += (1 - second) * (latent**2 - self._second)
        largest = np.sqrt(self._second.max() / (1 - second**self._steps))
        if largest > 0:
            self._latent -= rate / (1 - first**self._steps) / largest * self._first
            self.offsets = np.ascontiguousarray(self._factors.solve(self._areas[:, None] * self._latent))
