"""Poses the dressed performer: skins or drapes the clothes, folds them, and pushes them out of the body."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.mesh import vertex_normals
from ndf_mi.body.skinning import SkinnedVertices, joint_transforms
from ndf_mi.capture.synthesise.layers import Layer
from ndf_mi.capture.synthesise.plan import Look
from ndf_mi.capture.synthesise.surface import averaging
from ndf_mi.capture.synthesise.wardrobe import dress

#: Largest distance in metres by which a cloth vertex moves out of the body at once.
_MOST_PUSH = 0.05


class Performer:
    """Anny's ``body``, with shape coefficients ``shape``, (B,), and the layers that it wears.

    Attributes:
        layers: all visible surfaces; the naked body is not one of them.
    """

    def __init__(self, body: Body, shape: np.ndarray, look: Look = Look()) -> None:  # noqa: B008
        assert body.joints is not None and body.joint_dirs is not None
        self.body = body
        self.shape = np.asarray(shape, dtype=np.float32)
        self.layers: list[Layer] = dress(body, self.shape, look)
        self._skinned = [SkinnedVertices(layer.rest, layer.weights) for layer in self.layers]
        at = body.joints + body.joint_dirs @ self.shape
        self._joints = SkinnedVertices(at, np.eye(len(at)))
        self._mean = [averaging(layer.faces, len(layer.rest)) for layer in self.layers]

    def pose(
        self, pose: np.ndarray, root_rotation: np.ndarray, translation: np.ndarray, naked: np.ndarray
    ) -> list[np.ndarray]:
        """World vertices (N, 3) float32 of every layer.

        Args:
            pose, root_rotation, translation: as in ``Poses``, (J, 3), (3,) and (3,).
            naked: (V, 3) the posed body.
        """
        assert self.body.joint_names is not None
        transforms = joint_transforms(self.body, pose, root_rotation, translation, self.shape)
        by_name = dict(zip(self.body.joint_names, pose.astype(np.float64), strict=True))
        down = -Rotation.from_rotvec(root_rotation).as_matrix()[:, 1]
        joints = np.array(self._joints.apply(transforms), dtype=np.float64).reshape(-1, 3)
        keep_out = _Outside(naked.astype(np.float64), self.body.faces)
        posed = []
        for layer, skinned, mean in zip(self.layers, self._skinned, self._mean, strict=True):
            vertices = np.array(skinned.apply(transforms), dtype=np.float64).reshape(-1, 3)
            if layer.drape is not None:
                vertices = layer.drape(vertices[: len(layer.drape.phi)], joints)
            if layer.folds is not None:
                normals = vertex_normals(vertices, layer.faces)
                # Cloth on or below a limb hangs, then folds.
                hang = layer.slack * (normals @ down) ** 2
                fold = layer.folds.displacement(by_name)
                vertices = vertices + hang[:, None] * down + fold[:, None] * normals
            if layer.clearance is not None:
                vertices = keep_out(vertices, layer.clearance, mean)
            posed.append(vertices.astype(np.float32))
        return posed


class _Outside:
    """Moves vertices out of the posed body, (V, 3) with (F, 3) faces.

    The body is approximated by the tangent plane of its nearest vertex, which suffices for vertices 1 to 2 cm
    apart.
    """

    def __init__(self, naked: np.ndarray, faces: np.ndarray) -> None:
        self._naked = naked
        self._normals = vertex_normals(naked, faces)
        self._tree = cKDTree(naked)

    def __call__(self, vertices: np.ndarray, clearance: float, mean: csr_matrix) -> np.ndarray:
        """Vertices at least ``clearance`` metres outside; ``mean`` smooths the first move."""
        push = self._push(vertices, clearance)
        for _ in range(4):
            push = mean @ push
        vertices = vertices + push
        # A move out of one limb may end in another, so it is repeated.
        for _ in range(3):
            vertices = vertices + self._push(vertices, clearance)
        return vertices

    def _push(self, vertices: np.ndarray, clearance: float) -> np.ndarray:
        _, nearest = self._tree.query(vertices)
        normals = self._normals[nearest]
        height = np.sum((vertices - self._naked[nearest]) * normals, axis=1)
        return np.clip(clearance - height, 0, _MOST_PUSH)[:, None] * normals
