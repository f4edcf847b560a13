"""Derivatives of the distances between the outlines of a skinned surface and of masks, in what the fit of a
capture consists of: joint angles, root, translation, shape, cameras.

A point x on the surface's outline that moves by dx moves its outline by u · dx along the outline's normal u.
The derivatives hold the point and the normal fixed: sliding along the outline changes nothing to first order.
"""

from __future__ import annotations

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import joint_transforms
from ndf_mi.capture.camera import Camera
from ndf_mi.surface.outline_fit import Moves


class PoseJacobian:
    """Motion of points on a skinned surface in one frame by its joints, root and translation.

    Pose blend shapes are held fixed.

    Args:
        body: with a skinning model.
        poses: of all frames.
        row: of the frame in `poses`.
        offsets: (V, 3) added to the template, metres.
        turn: (3,) rotation vector, radians, of a turn of the whole body about its root joint in world axes
            that `poses` includes; derivatives of its components are taken here.
    """

    def __init__(self, body: Body, poses: Poses, row: int, offsets: np.ndarray, turn: np.ndarray) -> None:
        assert body.template is not None and body.weights is not None
        assert body.joints is not None and body.parents is not None
        rest, joints = body.template + offsets, body.joints.astype(np.float64)
        if poses.shape is not None and body.shape_dirs is not None:
            rest = rest + body.shape_dirs @ poses.shape
        if poses.shape is not None and body.joint_dirs is not None:
            joints = joints + body.joint_dirs @ poses.shape
        matrices = np.asarray(joint_transforms(
            body, poses.pose[row], poses.root_rotation[row], poses.translation[row], poses.shape).matrices)
        matrices = matrices.astype(np.float64).reshape(-1, 3, 4)
        self._rest, self._weights, self._matrices = rest, body.weights, matrices
        self._below = _below(body.parents)
        self._joints = np.einsum("jab,jb->ja", matrices[:, :, :3], joints) + matrices[:, :, 3]
        angles = poses.pose[row].astype(np.float64)
        angles[0] = turn
        above = matrices[np.maximum(body.parents, 0), :, :3]
        above[0] = np.eye(3)
        self._axes = above @ np.stack([left_jacobian(angle) for angle in angles])

    def rows(self, moves: Moves) -> np.ndarray:
        """(N, 3·J + 3) derivatives of where the surface's outline is along `moves.direction`: metres per
        radian of the root's turn and of what is added to the joints' axis-angles, and per metre of shift.
        """
        count = self._joints.shape[0]
        carried = np.zeros((len(moves.start), count, 3))
        total = np.zeros((len(moves.start), count))
        for index, share in ((moves.start, 1 - moves.position), (moves.end, moves.position)):
            weight = self._weights[index] * share[:, None]
            at = np.einsum("jab,nb->nja", self._matrices[:, :, :3], self._rest[index])
            carried += weight[..., None] * (at + self._matrices[:, :, 3])
            total += weight
        # What hangs below a joint turns about it: Σ w (x - joint) over the joints that it carries.
        arms = np.einsum("nia,ij->nja", carried, self._below, optimize=True)
        arms -= (total @ self._below)[..., None] * self._joints
        torque = np.cross(arms, moves.direction[:, None])
        turns = np.einsum("nja,jak->njk", torque, self._axes)
        return np.concatenate([turns.reshape(len(turns), -1), moves.direction], axis=1)


def camera_rows(camera: Camera, moves: Moves) -> np.ndarray:
    """(N, 7) the same derivatives for a rotation of the camera about its centre, in world axes, for a shift
    of its centre and for the logarithm of its focal length.
    """
    arm = moves.point - camera.position
    back = np.asarray(camera.transform, dtype=np.float64)[:3, 2]
    across = arm - (arm @ back)[:, None] * back
    return np.concatenate([-np.cross(arm, moves.direction), -moves.direction,
                           (across * moves.direction).sum(1, keepdims=True)], axis=1)


def vertex_rows(moves: Moves, motion: np.ndarray) -> np.ndarray:
    """(N, B) the same derivatives for B motions of the vertices (V, 3, B), metres."""
    start, end = (np.einsum("nab,na->nb", motion[index], moves.direction)
                  for index in (moves.start, moves.end))
    return np.asarray(start + moves.position[:, None] * (end - start))


def left_jacobian(angle: np.ndarray) -> np.ndarray:
    """(3, 3) J with exp(angle + δ) = exp(J δ) exp(angle) to first order, for a rotation vector in radians."""
    size = float(np.linalg.norm(angle))
    x, y, z = angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if size < 1e-4:
        return np.asarray(np.eye(3) + 0.5 * cross)
    return np.asarray(np.eye(3) + (1 - np.cos(size)) / size**2 * cross
                      + (size - np.sin(size)) / size**3 * cross @ cross)


def _below(parents: np.ndarray) -> np.ndarray:
    """(J, J) 1 where the row's joint is the column's or below it."""
    below = np.eye(len(parents))
    for joint, parent in enumerate(parents):
        if parent >= 0:
            below[joint] += below[parent]
    return below
