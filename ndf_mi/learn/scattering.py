"""Training through scattering: the field's density is an extinction and its colour an albedo, under lights that are known."""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.learn.loss import NoisyLoss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.rays import RayBatch
from ndf_mi.learn.scattering_scene import ScatteringScene, expect_outside
from ndf_mi.learn.trainer import Step, Trainer
from ndf_mi.model import PosedModel
from ndf_mi.render.lights import lights
from ndf_mi.render.replay import Replay, repeated
from ndf_mi.run import QUADRATURE, Run

SCATTERING = ("prbvolpath",)
"""Mitsuba's integrators that differentiate scattering media."""

SCATTERING_STEPS = 1000
"""Steps through scattering where nothing else is said: each costs as much as some twenty by quadrature."""

DENSITY_LIMIT = 150.0
"""The preset's `density_limit` in 1/m when training through scattering: paths cost by the majorant. It is opaque within 4 cm."""


def check_integrator(name: str) -> None:
    """Raises InputError unless fields can be trained by the integrator of this name."""
    if name == QUADRATURE or name in SCATTERING:
        return
    expected = f"{QUADRATURE} or {', '.join(SCATTERING)}"
    try:
        mi.load_dict({"type": name})
    except (RuntimeError, ValueError, TypeError):
        raise InputError("--integrator", f"{name!r}, which does not exist", expected) from None
    raise InputError("--integrator", f"{name!r}, which cannot differentiate media", expected)


def relightable(preset: Preset) -> tuple[Preset, list[str]]:
    """A preset for training through scattering, and what has been changed in it, as NAME=VALUE.

    The colours of such a field are its own: inputs that say where light comes from, or where the viewer is, are left out, and the pose,
    from which it can be told how a part was lit, mixes no matrices. Its density is
    above 0 wherever the networks decide: gradients through scattering are biased where it is 0.
    """
    changes: dict[str, Any] = {"direction_octaves": -1, "direction": "view", "normal_octaves": -1, "pose_products": False,
                               "density_limit": min(preset.density_limit, DENSITY_LIMIT), "density_activation": "softplus"}
    changed = [f"{key}={_told(value)}" for key, value in changes.items() if getattr(preset, key) != value]
    return dataclasses.replace(preset, **changes), changed


def _told(value: str | bool | float) -> str:
    """A value as `--option` takes it."""
    return value if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else format(value, "g")


class ScatteringTrainer(Trainer):
    """Trains the field of `run` as a scattering medium under the capture's lighting, after `warm_up` steps by quadrature.

    A step puts the field onto a lattice (batched networks, once), traces paths there, replays them for gradients in the lattice's nodes,
    and takes these back through the networks. The lattice is shifted by a random part of a cell each step, so that no detail can hide
    between nodes. Opacity against the masks and the band's edge are seen to by quadrature along the same rays.

    Raises:
        InputError: the light of the capture is not known or its scene is of no use; the preset lets light or viewer into the colours, or
            densities be 0; a camera is inside the performer's band.
    """

    def __init__(self, run: Run, capture: Capture, options: TrainingOptions) -> None:
        preset = run.model.field.preset
        for key in ("direction_octaves", "normal_octaves"):
            if getattr(preset, key) >= 0:
                raise InputError(f"preset option {key}", str(getattr(preset, key)), f"-1 with --integrator {options.integrator}",
                                 "Colours that depend on it hold the light of the capture, and cannot be shown under another.")
        if preset.density_activation == "relu":
            raise InputError("preset option density_activation", "relu", f"softplus with --integrator {options.integrator}",
                             "Gradients through scattering are biased where the density is 0, and it would stay 0 there.")
        self._lights = lights(capture.known_lighting())
        super().__init__(run, capture, options)
        train = capture.splits["train"]
        self._frames = train.frames
        for name in train.cameras:
            for frame in train.frames:
                expect_outside(run, capture.cameras[name], frame, options.cell)
        self._behind = srgb_to_linear(mi.Color3f(*[float(v) for v in run.background]))
        self._noisy = NoisyLoss(options.paths)
        self._stage: ScatteringScene | None = None

    @property
    def scattering(self) -> bool:
        """Whether the next step is one through scattering."""
        return self._step >= self.options.warm_up

    def step(self) -> None:
        """As the base class; the first step through scattering begins with fresh moments and, unless `seconds` or `decay_steps` rule the
        decay, with rates as at the start; but for what refused steps have left of them."""
        if self._step == self.options.warm_up and self._stage is None and self._step > 0:
            self.publish()
            before = self._guard
            self._make_optimisers()
            self._guard.follow(before)
            self._error = float("nan")
        super().step()

    def _gradients(self, batch: RayBatch) -> Step:
        if not self.scattering:
            return super()._gradients(batch)
        stage, replay = self._set_up()
        seen = self._see(batch)
        posed = PosedModel(self.run.model, self.parameters, self.run.surface(batch.frame), self._pose)
        baked = stage.place(posed, batch.frame, self._rng.random(3))
        ray = repeated(mi.Ray3f(mi.Point3f(batch.origin), mi.Vector3f(batch.direction)), self.options.paths)
        seed = int(self._rng.integers(2**32))
        radiance = replay.radiance(ray, seed)
        error, adjoint = self._noisy(radiance, mi.Color3f(batch.target))
        replay.backward(ray, seed, radiance, adjoint)
        shape = self._loss.shape(seen, mi.Float(batch.mask), mi.Float(batch.sure))
        dr.backward(shape + baked.pulled(stage.gradient()))
        return Step(error + dr.detach(shape), error, seen)

    def _set_up(self) -> tuple[ScatteringScene, Replay]:
        """The scene and what traces it, made when they are needed first."""
        if self._stage is None:
            self._stage = ScatteringScene(self.run, self._frames, self._lights, self.options.cell)
            integrator = mi.load_dict({"type": self.options.integrator, "max_depth": self.options.max_depth, "hide_emitters": True})
            self._replay = Replay(self._stage.scene, integrator, self._behind)
        return self._stage, self._replay

    def _spent(self) -> float:
        """The rates decay over the steps by quadrature, and again over those through scattering; once over all of them where `seconds` or
        `decay_steps` rule the decay."""
        warm = self.options.warm_up
        if self.options.seconds > 0 or self.options.decay_steps:
            return super()._spent()
        if not self.scattering:
            return self._step / warm
        return (self._step - warm) / max(self.options.steps - warm, 1)
