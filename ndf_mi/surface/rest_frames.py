"""Vertex offsets in frames that move with the skin, and their positions in world space."""

from __future__ import annotations

import numpy as np

from ndf_mi.body.mesh import vertex_normals
from ndf_mi.body.skinning import joint_transforms
from ndf_mi.capture.capture import Capture


class RestFrames:
    """Maps offsets at rest to world space: V_i = vertices_i + A_i d_i, with a 3 × 3 matrix A_i for each
    vertex and frame.

    With a skinning model, rest is the model's, at the capture's shape, and A_i is the linear part of the
    vertex's blended joint transforms: the result is what the same skinning makes of the template plus d.
    Without one, rest is the mesh of the first training frame (of the first pose if there is none), and A_i
    turns the vertex's tangent frame there into its tangent frame now: the normal, and the direction of one
    edge in the tangent plane.

    Args:
        capture: whose body and poses are used.

    Attributes:
        vertices: (V, 3) float64, the mesh at rest, metres.
    """

    def __init__(self, capture: Capture) -> None:
        self._body, self._poses = capture.body, capture.poses
        body, poses = self._body, self._poses
        if body.skinned:
            assert body.template is not None
            self.vertices = body.template.astype(np.float64)
            if poses.shape is not None and body.shape_dirs is not None:
                self.vertices = self.vertices + body.shape_dirs @ poses.shape
        else:
            train = capture.splits["train"].frames
            self.vertices = poses.vertices[poses.index(train[0]) if train else 0].astype(np.float64)
            self._neighbour = _a_neighbour(body.faces, len(self.vertices))
            self._frames = self._tangent_frames(self.vertices)
        self._joints: dict[int, np.ndarray] = {}
        self._last: tuple[int, np.ndarray] | None = None

    def linear(self, frame: int) -> np.ndarray:
        """(V, 3, 3) A_i of a frame. Raises InputError listing the frames if there is no such frame."""
        row = self._poses.index(frame)
        if self._last is None or self._last[0] != row:
            self._last = row, self._linear(row)
        return self._last[1]

    def _linear(self, row: int) -> np.ndarray:
        if not self._body.skinned:
            now = self._tangent_frames(self._poses.vertices[row].astype(np.float64))
            return np.einsum("vij,vkj->vik", now, self._frames)
        if row not in self._joints:
            p = self._poses
            moved = joint_transforms(
                self._body, p.pose[row], p.root_rotation[row], p.translation[row], p.shape)
            self._joints[row] = moved.matrices.numpy().reshape(-1, 3, 4)[:, :, :3].reshape(-1, 9)
        return (self._body.weights @ self._joints[row]).reshape(-1, 3, 3)

    def posed(self, frame: int, offsets: np.ndarray) -> np.ndarray:
        """(V, 3) float32 world positions of the body with the offsets (V, 3), metres."""
        base = self._poses.vertices[self._poses.index(frame)]
        return base + np.einsum("vij,vj->vi", self.linear(frame), offsets).astype(np.float32)

    def vjp(self, frame: int, gradient: np.ndarray) -> np.ndarray:
        """(V, 3) the gradient in the offsets, A_iᵀ g_i, of a loss with this gradient (V, 3) in world
        positions.
        """
        return np.einsum("vij,vi->vj", self.linear(frame), gradient)

    def _tangent_frames(self, vertices: np.ndarray) -> np.ndarray:
        """(V, 3, 3), columns tangent, bitangent, normal; orthonormal."""
        normal = _unit(vertex_normals(vertices, self._body.faces), np.array([0.0, 0.0, 1.0]))
        edge = vertices[self._neighbour] - vertices
        across = np.eye(3)[np.abs(normal).argmin(axis=1)]
        tangent = _unit(_tangential(edge, normal), _unit(_tangential(across, normal), across))
        return np.stack([tangent, np.cross(normal, tangent), normal], axis=-1)


def _a_neighbour(faces: np.ndarray, count: int) -> np.ndarray:
    """(V,) a vertex that an edge joins to each vertex; itself where there is none."""
    neighbour = np.arange(count)
    neighbour[faces.ravel()] = faces[:, [1, 2, 0]].ravel()
    return neighbour


def _tangential(vectors: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return vectors - (vectors * normal).sum(1, keepdims=True) * normal


def _unit(vectors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Unit vectors; `otherwise` where the length is almost zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), otherwise)
