"""Corrections of the fitted body: joints, place and shape, through its skinning."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import rodrigues, skin
from ndf_mi.learn.corrections import Corrections, rows

JOINT = math.radians(5.0)
"""Standard deviation of each component of a joint's correction, radians: what fits to a few cameras err by.
Joints that the images hardly show stay where the fit has them."""

TRANSLATION = 0.02
"""Standard deviation of each component of the shift, metres."""

SHAPE = 0.01
"""Root mean square displacement of the vertices, metres, by one standard deviation of a shape coefficient."""


class PoseCorrections:
    """The vertices of the corrected body in the training frames, and of the corrected shape in all frames.

    A frame's row holds 3·J + 3 numbers: the rotation of the whole body about its root joint, in world axes;
    the axis-angles added to those of the other joints; the shift. So a turn moves the body as little as it
    can, and does not mix with the shift.

    Over time, each of these numbers is a stationary Gaussian process whose correlation falls as
    exp(−|Δ|/τ), with Δ and τ in frames; its logarithm is the sum of a pull to zero and of squared differences
    of neighbouring frames, divided by their distance. What is trained are independent standard normal numbers
    y, from which the process is made by the square root of its covariance, z = C^½ y: a step in one frame
    moves its neighbours with it.

    Bodies whose vertices in `poses` differ from what `skin` makes of them keep the difference, constant in
    world space. Without corrections the vertices are exactly those of `poses`.

    Args:
        body: with a skinning model.
        poses: before any correction.
        frames: the training frames.
        correlation: τ, frames.

    Attributes:
        deviations: (3·J + 3,) standard deviations of a row's numbers, radians and metres.
        shape_deviations: (B,) those of the shape coefficients.
    """

    def __init__(self, body: Body, poses: Poses, frames: Sequence[int], correlation: float) -> None:
        self.poses = poses
        self.frames = tuple(int(frame) for frame in frames)
        self._body = body
        self._row = {frame: row for row, frame in enumerate(self.frames)}
        self._mixing = mixing(np.array(self.frames), correlation)
        joints = body.joint_count
        self._columns = 3 * joints + 3
        self.deviations = np.array([JOINT] * 3 * joints + [TRANSLATION] * 3)
        self._scale = mi.Float(self.deviations.astype(np.float32))
        self._shape = np.zeros(body.shape_count) if poses.shape is None else poses.shape.astype(np.float64)
        self.shape_deviations = np.zeros(0)
        if body.shape_dirs is not None:
            move = np.sqrt(np.square(body.shape_dirs.astype(np.float64)).sum(1).mean(0))
            self.shape_deviations = SHAPE / np.maximum(move, 1e-9)
        self._unmoved: dict[int, mi.Float] = {}

    @property
    def pose_count(self) -> int:
        """How many numbers `Corrections.pose` has."""
        return self._columns * len(self.frames)

    @property
    def shape_count(self) -> int:
        """How many numbers `Corrections.shape` has."""
        return len(self.shape_deviations)

    def vertices(self, corrections: Corrections, frame: int) -> mi.Float:
        """The vertices in a frame, flat (3·V), world, metres; attached, and evaluated."""
        at = self.poses.index(frame)
        if frame not in self._unmoved:
            self._unmoved[frame] = self._skinned(at, None, None)
        pose = None if corrections.pose is None else self._pose(corrections.pose, frame)
        moved = self._skinned(at, pose, corrections.shape) - self._unmoved[frame]
        vertices = _flat(self.poses.vertices[at]) + moved
        dr.eval(vertices)
        return vertices

    def angles(self, corrections: Corrections, frame: int) -> np.ndarray:
        """(3·J,) radians, what is added to a frame's joint angles; zero for the root and in other frames."""
        if corrections.pose is None or frame not in self._row:
            return np.zeros(self._columns - 3)
        row = self._rows(corrections.pose)[self._row[frame], :-3]
        return np.concatenate([np.zeros(3), row[3:]])

    def baked(self, corrections: Corrections) -> Poses:
        """All poses with the corrections: training frames with their own, all frames with the shape's."""
        poses = self.poses
        pose, root, shift, vertices = (np.array(getattr(poses, name)) for name in (
            "pose", "root_rotation", "translation", "vertices"))
        for at, frame in enumerate(poses.frames.tolist()):
            if frame not in self._row and corrections.shape is None:
                continue
            vertices[at] = np.asarray(dr.detach(self.vertices(corrections, frame))).reshape(-1, 3)
            if corrections.pose is None or frame not in self._row:
                continue
            pose[at] += self.angles(corrections, frame).reshape(-1, 3)
            row = self._rows(corrections.pose)[self._row[frame]]
            turn, pivot = Rotation.from_rotvec(row[:3]), self._pivot(at)
            root[at] = (turn * Rotation.from_rotvec(root[at].astype(np.float64))).as_rotvec()
            shift[at] = turn.apply(shift[at] - pivot) + pivot + row[-3:]
        shape = poses.shape
        if corrections.shape is not None:
            shape = self._shape + self.shape_offsets(corrections.shape)
        return dataclasses.replace(poses, pose=pose, root_rotation=root, translation=shift, vertices=vertices,
                                   shape=shape)

    def numbers(self, values: np.ndarray) -> mi.Float:
        """`Corrections.pose` that has these corrections (T, 3·J + 3), radians and metres."""
        return _flat(np.linalg.solve(self._mixing, values / self.deviations))

    def shape_offsets(self, shape: mi.Float) -> np.ndarray:
        """(B,) what is added to the shape coefficients."""
        return rows(shape, 1)[:, 0] * self.shape_deviations

    def tensors(self, corrections: Corrections) -> dict[str, np.ndarray]:
        """The corrections in radians, metres and shape coefficients, float32: `frames` (T,) int32, `pose`
        (T, J, 3), whose root is the rotation about the root joint, `translation` (T, 3), `shape` (B,)."""
        found: dict[str, np.ndarray] = {}
        if corrections.pose is not None:
            values = self._rows(corrections.pose).astype(np.float32)
            found = {"frames": np.array(self.frames, np.int32),
                     "pose": values[:, :-3].reshape(len(values), -1, 3).copy(),
                     "translation": values[:, -3:].copy()}
        if corrections.shape is not None:
            found["shape"] = self.shape_offsets(corrections.shape).astype(np.float32)
        return found

    def _pose(self, pose: mi.Float, frame: int) -> mi.Float | None:
        """A frame's row in radians and metres, attached; None where the frame has none."""
        if frame not in self._row:
            return None
        weights = mi.TensorXf(_flat(self._mixing[self._row[frame]]), (1, len(self.frames)))
        mixed = weights @ mi.TensorXf(pose, (len(self.frames), self._columns))
        return mixed.array * self._scale

    def _rows(self, pose: mi.Float) -> np.ndarray:
        """(T, 3·J + 3) float64, all frames' corrections in radians and metres."""
        return np.asarray(self._mixing @ rows(pose, self._columns) * self.deviations)

    def _skinned(self, at: int, row: mi.Float | None, shape: mi.Float | None) -> mi.Float:
        """`skin` of row number `at` of the poses with corrections, without what `poses` adds to it."""
        poses, joints = self.poses, self._columns - 3
        row = dr.zeros(mi.Float, self._columns) if row is None else row
        lane = dr.arange(mi.UInt32, joints)
        angles = dr.select(lane < 3, 0.0, dr.gather(mi.Float, row, lane))
        pose = _flat(poses.pose[at]) + angles
        coefficients = None
        if self.shape_count:
            coefficients = _flat(self._shape)
            if shape is not None:
                coefficients = coefficients + shape * _flat(self.shape_deviations)
        posed = dr.unravel(mi.Point3f, skin(self._body, pose, poses.root_rotation[at], poses.translation[at],
                                            coefficients))
        pivot = mi.Point3f(*[dr.opaque(mi.Float, float(v)) for v in self._pivot(at)])
        turn, shift = (mi.Vector3f(*[dr.gather(mi.Float, row, mi.UInt32(first + k)) for k in range(3)])
                       for first in (0, joints))
        moved = rodrigues(turn) @ mi.Vector3f(posed - pivot) + pivot + shift
        flat = dr.ravel(mi.Point3f(moved))
        dr.eval(flat)
        return flat

    def _pivot(self, at: int) -> np.ndarray:
        """(3,) the root joint in row number `at` of the poses, world, metres."""
        body, poses = self._body, self.poses
        assert body.joints is not None
        joint = body.joints[0].astype(np.float64)
        if body.joint_dirs is not None:
            joint = joint + body.joint_dirs[0].astype(np.float64) @ self._shape
        turn = Rotation.from_rotvec(poses.root_rotation[at].astype(np.float64))
        return np.asarray(turn.apply(joint) + poses.translation[at])


def mixing(frames: np.ndarray, correlation: float) -> np.ndarray:
    """(T, T) float64, the symmetric square root of the covariance exp(−|Δ|/τ) of frames.

    Args:
        frames: (T,) ascending numbers.
        correlation: τ, frames; 0 makes frames independent.
    """
    apart = np.abs(frames[:, None] - frames[None]).astype(np.float64)
    covariance = np.exp(-apart / correlation) if correlation > 0 else np.eye(len(frames))
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T)


def _flat(values: np.ndarray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(values, np.float32).ravel())
