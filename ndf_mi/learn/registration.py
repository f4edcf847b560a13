"""The first stage of refinement: poses, shape and cameras are fitted to the outlines of the training masks,
before there is a field.

Points on the outline of the posed surface measure how far away the mask's outline is (`surface.outline_fit`).
With the derivatives J of these distances r (`surface.outline_jacobian`), each round takes a step of Gauss and
Newton on

    Σ w/σ² ρ(r - J δ) + the prior of the corrections (`pose_corrections`, `camera_corrections`)

with lengths of outline w and the robust function ρ of Geman and McClure. Rounds begin with a large σ, so that
the prior allows only motions that many points agree on, and with a wide ρ. After some rounds they alternate
with rounds of offsets, which take up what clothes add to the body in all frames; cameras follow last.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import mitsuba as mi
import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.learn.camera_corrections import COLUMNS, DEVIATIONS, corrected
from ndf_mi.learn.corrections import Corrections
from ndf_mi.learn.normal_equations import NormalEquations, precision
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.pose_corrections import PoseCorrections
from ndf_mi.surface.outline_fit import OutlineFit
from ndf_mi.surface.outline_jacobian import PoseJacobian, camera_rows, vertex_rows
from ndf_mi.surface.outline_views import OutlineViews
from ndf_mi.surface.rest_frames import RestFrames

SAMPLES = 512
"""Contour points a view."""

APART = 0.03
"""Metres of outline over which errors are independent: so much counts as one measurement."""

NOISE = (0.1, 0.02)
"""σ of the first and the last round, metres."""

ROBUST = (0.2, 0.03)
"""Distance beyond which ρ grows no further, of the first and the last round, metres."""

LENGTHS = (0.1, 0.03)
"""Metres over which the first and the last round of offsets move the surface smoothly."""

OFFSETS_FROM, CAMERAS_FROM = 0.1, 0.4
"""Share of the rounds before offsets move, and before cameras do where poses are refined: while poses are far
off, they would take up the poses' errors.
"""

FEW, FEW_UNTIL = 16, 0.7
"""Frames that suffice before that share of the rounds, where poses are correlated over time."""

OFFSETS = 2
"""Rounds of offsets, a few frames each, for each round of poses."""

SHAPE_STEP = 0.1
"""Step of the differences that give the motion by a shape coefficient, in its standard deviations."""

PREFIX = "registered."
"""What names of these corrections in `Run.surface_tensors` begin with."""


@dataclass(frozen=True)
class Registered:
    """What registration found.

    Attributes:
        capture: with the corrected poses and cameras.
        tensors: the corrections in radians, metres, shape coefficients and logarithms, as
            `PoseCorrections.tensors` and `CameraCorrections.tensors` name them, each after `PREFIX`.
    """

    capture: Capture
    tensors: Mapping[str, np.ndarray] = field(default_factory=dict)


class Registration:
    """Corrections that bring the outlines of surface and masks together.

    Args:
        capture: what :func:`check_refinable` allows.
        refine: what is corrected, as `TrainingOptions.refine`.
        correlation: frames over which corrections of poses are correlated.
        seed: of points on contours and of the views for offsets.

    Attributes:
        capture: with the corrected poses and cameras.
    """

    def __init__(self, capture: Capture, refine: Sequence[str], correlation: float, seed: int) -> None:
        split = capture.splits["train"]
        self._given, self.capture = capture, capture
        self._frames, self._names = split.frames, split.cameras
        self._links = precision(np.array(self._frames), correlation)
        self._body: PoseCorrections | None = None
        columns = shapes = 0
        if "pose" in refine or "shape" in refine:
            self._body = PoseCorrections(capture.body, capture.poses, split.frames, correlation)
            columns = len(self._body.deviations) if "pose" in refine else 0
            shapes = self._body.shape_count if "shape" in refine else 0
        cameras = len(self._names) if "cameras" in refine else 0
        # In standard deviations of their priors.
        self._pose = np.zeros((len(self._frames), columns))
        self._shape = np.zeros(shapes)
        self._cameras = np.zeros((cameras, COLUMNS))
        self._views = OutlineViews(capture, seed)
        self._fit = OutlineFit(RestFrames(capture), capture.body.faces, seed)

    @property
    def corrections(self) -> Corrections:
        """Those of pose and shape, as training has them."""
        pose = shape = None
        if self._body is not None and self._pose.size:
            pose = self._body.numbers(self._pose * self._body.deviations)
        if self._shape.size:
            shape = mi.Float(self._shape.astype(np.float32))
        return Corrections(pose=pose, shape=shape)

    def step(self, noise: float, robust: float, cameras: bool, every: int = 1) -> None:
        """One step of Gauss and Newton.

        Args:
            noise: σ, metres.
            robust: the width of ρ, metres.
            cameras: whether cameras move.
            every: 2 measures every second frame, and so on; the prior interpolates poses between them.
        """
        shared = np.concatenate([self._shape, self._cameras.ravel()])
        equations = NormalEquations(self._pose, shared, self._links)
        for row, frame in list(enumerate(self._frames))[::every]:
            self._add(equations, row, frame, noise, robust, cameras)
        pose, shared = equations.solve()
        self._pose += pose
        self._shape += shared[: len(self._shape)]
        if cameras:
            self._cameras += shared[len(self._shape) :].reshape(self._cameras.shape)
        capture = self._given.with_cameras([self._camera(self._given.cameras[name]) for name in self._names])
        if self._body is not None:
            capture = capture.with_body(capture.body, self._body.baked(self.corrections))
        self.capture = capture
        self._fit.follow(RestFrames(capture))

    def move_offsets(self, length: float) -> None:
        """One round of offsets in a few frames, smooth over `length` metres."""
        views = {frame: [(self._camera(camera), matte) for camera, matte in seen]
                 for frame, seen in self._views.next().items()}
        self._fit.step(views, length)

    def tensors(self) -> dict[str, np.ndarray]:
        """See `Registered.tensors`."""
        found = {} if self._body is None else self._body.tensors(self.corrections)
        if self._cameras.size:
            values = (self._cameras * DEVIATIONS).astype(np.float32)
            found |= {"camera_rotation": values[:, :3].copy(), "camera_translation": values[:, 3:6].copy(),
                      "camera_focal": values[:, 6].copy()}
        return {PREFIX + name: value for name, value in found.items()}

    def _add(self, equations: NormalEquations, row: int, frame: int, noise: float, robust: float,
             cameras: bool) -> None:
        """Adds all views of a frame."""
        views = [(self._camera(camera), matte)
                 for camera, matte in (self._views.view(name, frame) for name in self._names)]
        jacobian, body = None, self._body
        if body is not None and self._pose.size:
            poses = self.capture.poses
            turn = (self._pose[row] * body.deviations)[:3]
            jacobian = PoseJacobian(self.capture.body, poses, poses.index(frame), self._fit.offsets, turn)
        motion = self._shape_motion(frame)
        for index, moves in enumerate(self._fit.moves(frame, views, SAMPLES)):
            if moves is None:
                continue
            own = np.zeros((len(moves.distance), 0))
            if jacobian is not None and body is not None:
                own = jacobian.rows(moves) * body.deviations
            seen = np.zeros((len(moves.distance), *self._cameras.shape))
            if cameras and len(self._cameras):
                seen[:, index] = camera_rows(views[index][0], moves) * DEVIATIONS
            shared = np.concatenate([vertex_rows(moves, motion), seen.reshape(len(seen), -1)], axis=1)
            weight = moves.found * moves.length / (APART * noise**2)
            weight /= (1 + (moves.distance / robust) ** 2) ** 2
            equations.add(row, own, shared, moves.distance, weight)

    def _camera(self, camera: Camera) -> Camera:
        """A training camera, in any size, with its correction."""
        if not len(self._cameras):
            return camera
        values = self._cameras[self._names.index(camera.name)] * DEVIATIONS
        return corrected(camera, values[:3], values[3:6], float(values[6]))

    def _shape_motion(self, frame: int) -> np.ndarray:
        """(V, 3, B) metres by one standard deviation of each shape coefficient."""
        count = len(self._given.poses.vertices[0])
        if self._body is None or not len(self._shape):
            return np.zeros((count, 3, 0))
        now = self._vertices(self._body, self._shape, frame)
        moved = [self._vertices(self._body, self._shape + step, frame)
                 for step in SHAPE_STEP * np.eye(len(self._shape))]
        return (np.stack(moved, axis=-1) - now[..., None]) / SHAPE_STEP

    def _vertices(self, body: PoseCorrections, shape: np.ndarray, frame: int) -> np.ndarray:
        corrections = Corrections(pose=self.corrections.pose, shape=mi.Float(shape.astype(np.float32)))
        return np.asarray(body.vertices(corrections, frame)).astype(np.float64).reshape(-1, 3)


def register(capture: Capture, options: TrainingOptions, budget: float | None = None,
             progress: Callable[[int], None] | None = None) -> Registered:
    """The capture with what `options.refine` names fitted to the outlines of the training masks.

    Args:
        capture: with a `train` split.
        options: `refine`, `refine_outlines`, `refine_frames` and `seed`.
        budget: wall-clock seconds to end by, about a round early or late; None takes all rounds.
        progress: called with the number of rounds so far.

    Raises:
        InputError: the body has not what is to be refined, there are no training images, or a mask cannot
            be read.
    """
    check_refinable(capture, capture.body, options.refine)
    rounds = options.refine_outlines if options.refine else 0
    if not rounds:
        return Registered(capture)
    start = time.perf_counter()
    found = Registration(capture, options.refine, options.refine_frames, options.seed)
    thinned = math.ceil(len(capture.splits["train"].frames) / FEW)
    if options.refine_frames < thinned:
        thinned = 1
    taken, done = 0, 0.0
    while done < 1:
        found.step(_between(NOISE, done), _between(ROBUST, done),
                   cameras=done >= CAMERAS_FROM or "pose" not in options.refine,
                   every=thinned if done < FEW_UNTIL else 1)
        if done >= OFFSETS_FROM:
            for _ in range(OFFSETS):
                found.move_offsets(_between(LENGTHS, done))
        taken += 1
        done = taken / rounds
        if budget is not None:
            done = max(done, (time.perf_counter() - start) / budget)
        if progress is not None:
            progress(taken)
    return Registered(found.capture, found.tensors())


def check_refinable(capture: Capture, body: Body, refine: Sequence[str]) -> None:
    """Raises InputError unless the body can be moved as `refine` asks.

    Args:
        capture: where it is from.
        body: the capture's, or a surface around it.
        refine: as `TrainingOptions.refine`.
    """
    where = f"{capture.path / 'body.npz'}"
    if not body.skinned and ("pose" in refine or "shape" in refine):
        raise InputError(where, "a body without skinning", "template, joints, parents and weights, which "
                         "--refine pose and --refine shape need",
                         "Import the capture with its body model, or refine only cameras.")
    if "shape" in refine and not body.shape_count:
        raise InputError(where, "a body without shape_dirs", "shape coefficients, which --refine shape "
                         "needs", "Leave out shape.")


def _between(ends: tuple[float, float], done: float) -> float:
    return float(ends[0] * (ends[1] / ends[0]) ** done)
