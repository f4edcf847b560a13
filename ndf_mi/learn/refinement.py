"""Trains corrections of the fit and of the cameras' colours together with the field."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.learn.batch import Batch
from ndf_mi.learn.camera_colours import CameraColours
from ndf_mi.learn.camera_corrections import CameraCorrections
from ndf_mi.learn.corrections import Corrections
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.pose_corrections import PoseCorrections
from ndf_mi.learn.registration import check_refinable
from ndf_mi.projection import PosedSurface
from ndf_mi.run import Run

INITIAL = "initial_poses.npz"
"""The file in a run's folder with its poses before the field refined them."""

PREFIX = "refined."
"""What names of corrections in `Run.surface_tensors` begin with."""

CAMERAS = "refined_cameras"
"""The key in `Run.config` of the training cameras' names, in the order of the tensors' rows."""


@dataclasses.dataclass(frozen=True)
class Fitted:
    """What a batch looks at, corrected.

    Attributes:
        surface: the reference surface; its vertices are attached where pose or shape are.
        ray: attached where cameras are.
        pose: flat (3·J) axis-angles for the networks, detached.
    """

    surface: PosedSurface
    ray: mi.Ray3f
    pose: mi.Float


class Refinement:
    """The corrections that a training's options ask for: their number, effect, prior and place in the run.

    The prior is that of standard normal numbers; a training minimises

        E[loss] + `refine_prior` / T · Σ z²

    over T training frames. A common turn of all cameras and all poses changes no image; of those that fit
    equally well the prior takes the smallest corrections.

    Args:
        run: its body and poses; :meth:`publish` replaces the poses.
        capture: frames and cameras of its `train` split.
        options: `refine`, `camera_colours` and what belongs to them.

    Raises:
        InputError: the body, the capture or the preset does not allow a correction.
    """

    def __init__(self, run: Run, capture: Capture, options: TrainingOptions) -> None:
        self._run = run
        self._options = options
        split = capture.splits["train"]
        cameras = [capture.cameras[name] for name in split.cameras]
        self._weight = options.refine_prior / max(len(split.frames), 1)
        self._cached: tuple[Corrections, dict[int, PosedSurface]] = Corrections(), {}
        self._body: PoseCorrections | None = None
        self._cameras: CameraCorrections | None = None
        self.colours: CameraColours | None = None
        if self._moves_body:
            check_refinable(capture, run.body, options.refine)
            if run.model.field.preset.coordinates == "world":
                raise InputError("--refine", "pose or shape with the preset option coordinates=world",
                                 "coordinates on the body",
                                 "In world space the field does not follow the body.")
            self._body = PoseCorrections(run.body, _initial_poses(run), split.frames, options.refine_frames)
        if "cameras" in options.refine:
            self._cameras = CameraCorrections(cameras)
        if options.camera_colours:
            if len(cameras) < 2:
                raise InputError("--camera-colours", f"{len(cameras)} training camera",
                                 "at least 2: colours are corrected relative to the cameras' mean")
            self.colours = CameraColours(len(cameras))
        if self._cameras is not None or self.colours is not None:
            run.config[CAMERAS] = list(split.cameras)

    @property
    def poses(self) -> Poses:
        """The run's poses before any correction."""
        return self._run.poses if self._body is None else self._body.poses

    def initial(self) -> dict[str, mi.Float]:
        """Zeros by the name of each group that is trained."""
        counts = {}
        if self._body is not None:
            counts = {"pose": self._body.pose_count, "shape": self._body.shape_count}
            counts = {name: count for name, count in counts.items() if name in self._options.refine}
        if self._cameras is not None:
            counts["cameras"] = self._cameras.count
        if self.colours is not None:
            counts["colours"] = self.colours.count
        return {name: dr.opaque(mi.Float, 0.0, count) for name, count in counts.items()}

    def fitted(self, corrections: Corrections, batch: Batch) -> Fitted:
        """What the batch's rays look at."""
        pose, ray = batch.pose, batch.ray
        if self._body is None or (corrections.pose is None and corrections.shape is None):
            surface = self._run.surface(batch.frame)
        else:
            surface = self._surface(self._body, corrections, batch.frame)
            pose = pose + self._body.angles(corrections, batch.frame).astype(np.float32)
        if self._cameras is not None and corrections.cameras is not None:
            ray = self._cameras.rays(corrections.cameras, mi.UInt32(batch.camera), ray)
        return Fitted(surface, ray, mi.Float(pose))

    def penalty(self, corrections: Corrections) -> mi.Float:
        """The prior's part of the loss, one number."""
        total = mi.Float(0.0)
        for value in corrections.groups().values():
            total = total + self._weight * dr.sum(dr.square(value))
        return total

    def frozen(self, corrections: Corrections, batch: Batch) -> Batch:
        """The batch with the corrections applied to rays, targets and pose, for steps that do not know them;
        the surface is that of the poses that :meth:`publish` has left in the run."""
        corrections = corrections.detached()
        fitted = self.fitted(corrections, batch)
        target = batch.target
        if self.colours is not None and corrections.colours is not None:
            target = self.colours.unseen(corrections.colours, batch.camera, target, batch.mask,
                                         self._run.background)
        return dataclasses.replace(batch, origin=np.asarray(fitted.ray.o), direction=np.asarray(fitted.ray.d),
                                   pose=np.asarray(fitted.pose), target=target)

    def publish(self, corrections: Corrections) -> None:
        """Puts the corrected poses and the corrections into the run."""
        corrections = corrections.detached()
        found: dict[str, np.ndarray] = {}
        if self._body is not None:
            found |= self._body.tensors(corrections)
            self._run.replace_poses(self._body.baked(corrections))
        if self._cameras is not None and corrections.cameras is not None:
            found |= self._cameras.tensors(corrections.cameras)
        if self.colours is not None and corrections.colours is not None:
            found |= self.colours.tensors(corrections.colours)
        self._run.surface_tensors |= {PREFIX + name: value for name, value in found.items()}

    def save_initial(self) -> None:
        """Writes the poses before any correction, unless they are there."""
        if self._body is not None and not (self._run.path / INITIAL).exists():
            self._body.poses.write(self._run.path / INITIAL)

    @property
    def _moves_body(self) -> bool:
        return "pose" in self._options.refine or "shape" in self._options.refine

    def _surface(self, body: PoseCorrections, corrections: Corrections, frame: int) -> PosedSurface:
        """The corrected surface; kept for the next call where the corrections are detached and the same."""
        moving = [value for value in (corrections.pose, corrections.shape) if value is not None]
        if dr.grad_enabled(moving):
            return self._run.model.pose(body.vertices(corrections, frame))
        cached, surfaces = self._cached
        if not (_same(cached.pose, corrections.pose) and _same(cached.shape, corrections.shape)):
            surfaces = {}
            # Held, so that their indices stay theirs.
            self._cached = corrections, surfaces
        if frame not in surfaces:
            surfaces[frame] = self._run.model.pose(body.vertices(corrections, frame))
        return surfaces[frame]


def _initial_poses(run: Run) -> Poses:
    """The poses before any correction: those of a file next to them if the run was refined before."""
    path = run.path / INITIAL
    return Poses.read(path, run.body) if path.exists() else run.poses


def _same(one: mi.Float | None, other: mi.Float | None) -> bool:
    """Whether both are the same variable, without a look at its values."""
    if one is None or other is None:
        return one is other
    return bool(one.index == other.index)
