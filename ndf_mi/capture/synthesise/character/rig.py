"""Anny's points and how they move with pose, translation, shape and size: values and derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body


@dataclass(frozen=True)
class Posed:
    """P points of one frame and their derivatives.

    Attributes:
        points: (P, 3) metres.
        by_turn: (P, 3, 3J) for the turn of each joint, see `Rig.pose`.
        by_shape: (P, 3, B + 1) for the shape coefficients and the logarithm of the size.
    """

    points: np.ndarray
    by_turn: np.ndarray
    by_shape: np.ndarray


class Rig:
    """Chosen ``vertices`` of a skinned body, followed by its J joints."""

    def __init__(self, body: Body, vertices: np.ndarray) -> None:
        assert body.template is not None and body.joints is not None and body.weights is not None
        assert body.shape_dirs is not None and body.joint_dirs is not None and body.parents is not None
        self.parents = body.parents
        count = len(body.joints)
        self._rest = np.concatenate([body.template[vertices], body.joints]).astype(float)
        self._dirs = np.concatenate([body.shape_dirs[vertices], body.joint_dirs]).astype(float)
        self._weights = np.concatenate([body.weights[vertices], np.eye(count)]).astype(float)
        self._joints, self._joint_dirs = body.joints.astype(float), body.joint_dirs.astype(float)
        self._below = np.eye(count)
        for j in reversed(range(1, count)):
            self._below[self.parents[j]] += self._below[j]

    def pose(self, start: np.ndarray, turns: np.ndarray, translation: np.ndarray, shape: np.ndarray,
             size: float) -> Posed:
        """The points in one frame.

        Args:
            start: (J, 3, 3) rotations relative to the parents; that of the root turns about the origin.
            turns: (J, 3) axis-angle, applied before ``start``: the rotation is start · exp(turn).
            translation: (3,) metres.
            shape: (B,).
            size: the logarithm of the factor on all lengths.
        """
        scale = np.exp(size)
        local = start @ Rotation.from_rotvec(turns).as_matrix()
        world, before = local.copy(), start.copy()
        for j, p in enumerate(self.parents):
            if p >= 0:
                world[j], before[j] = world[p] @ local[j], world[p] @ start[j]
        rest = scale * (self._rest + self._dirs @ shape)
        joints = scale * (self._joints + self._joint_dirs @ shape)
        pivots = self._places(world, joints[..., None])[..., 0] + translation
        shifts = pivots - np.einsum("jik,jk->ji", world, joints)
        # Each point moved with each joint alone, and its part in what all of them do.
        parts = np.einsum("jik,pk->pji", world, rest) + shifts
        weighted = self._weights[..., None] * parts
        points = weighted.sum(axis=1)
        # Turning joint k moves what is at it and below around it.
        moved = np.einsum("kj,pji->pki", self._below, weighted, optimize=True)
        share = self._weights @ self._below.T
        pivots[0] = translation
        arms = moved - share[..., None] * pivots
        axes = before @ _left_jacobians(turns)
        by_turn = np.cross(axes.transpose(0, 2, 1)[None], arms[:, :, None])
        by_turn = by_turn.reshape(len(points), -1, 3).transpose(0, 2, 1)
        blended = np.einsum("pj,jik->pik", self._weights, world, optimize=True)
        moves = self._places(world, self._joint_dirs) - world @ self._joint_dirs
        carried = np.einsum("pj,jib->pib", self._weights, moves, optimize=True)
        by_shape = scale * (blended @ self._dirs + carried)
        by_size = (points - translation)[..., None]
        return Posed(points, by_turn, np.concatenate([by_shape, by_size], axis=2))

    def _places(self, world: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """(J, 3, B) positions of joints, linear in the (J, 3, B) joints at rest."""
        out = np.empty_like(joints)
        for j, p in enumerate(self.parents):
            out[j] = world[0] @ joints[0] if p < 0 else out[p] + world[p] @ (joints[j] - joints[p])
        return out


def _left_jacobians(turns: np.ndarray) -> np.ndarray:
    """(J, 3, 3) J with exp(turn + d) ≈ exp(J·d)·exp(turn) (Solà et al. 2018, eq. 145)."""
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    skew = np.zeros((len(turns), 3, 3))
    skew[:, [2, 0, 1], [1, 2, 0]] = turns
    skew -= skew.transpose(0, 2, 1)
    small = angle < 1e-4
    safe = np.where(small, 1, angle)
    first = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + first * skew + second * skew @ skew
