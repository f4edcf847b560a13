"""Training through scattering: density is an extinction and colour an albedo, under known lights."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters, Preset
from ndf_mi.learn.batch import Batch
from ndf_mi.learn.corrections import NONE, Corrections
from ndf_mi.learn.loss import NoisyLoss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.refinement import Refinement
from ndf_mi.learn.scattering_scene import ScatteringScene, expect_outside
from ndf_mi.learn.step import QuadratureStep, Statistics, statistics
from ndf_mi.model import PosedModel
from ndf_mi.render.replay import Replay, repeated
from ndf_mi.render.scene import lights
from ndf_mi.run import QUADRATURE, Run

SCATTERING = ("prbvolpath",)
"""Mitsuba's integrators that differentiate scattering media."""

SCATTERING_STEPS = 1000
"""Default number of steps through scattering: each costs as much as about twenty by quadrature."""

DENSITY_LIMIT = 150.0
"""The preset's `density_limit` in 1/m for scattering, where paths cost in proportion to the majorant. A
medium of this extinction is opaque within 4 cm."""


def check_integrator(name: str) -> None:
    """Raises InputError unless fields can be trained with the integrator `name`."""
    if name == QUADRATURE or name in SCATTERING:
        return
    expected = f"{QUADRATURE} or {', '.join(SCATTERING)}"
    try:
        mi.load_dict({"type": name})
    except (RuntimeError, ValueError, TypeError):
        raise InputError("--integrator", f"{name!r}, which does not exist", expected) from None
    raise InputError("--integrator", f"{name!r}, which cannot differentiate media", expected)


def relightable(preset: Preset) -> tuple[Preset, list[str]]:
    """A preset for training through scattering, and the options that this changed, as NAME=VALUE.

    Its colours are albedos: inputs that depend on the light or the viewer are removed, and so are the pose
    products, which could learn how a part was lit in each pose. Its density is above 0 wherever the networks
    are evaluated: gradients through scattering are biased where it is 0.
    """
    changes: dict[str, Any] = {
        "direction_octaves": -1, "direction": "view", "normal_octaves": -1, "pose_products": False,
        "density_limit": min(preset.density_limit, DENSITY_LIMIT), "density_activation": "softplus"}
    changed = [f"{key}={f'{value:g}' if isinstance(value, float) else str(value).lower()}"
               for key, value in changes.items() if getattr(preset, key) != value]
    return dataclasses.replace(preset, **changes), changed


def capture_lights(run: Run, capture: Capture, options: TrainingOptions) -> dict[str, Any]:
    """The lights of a capture as entries of a scene's dictionary.

    Raises:
        InputError: training through scattering is impossible: the light is unknown or its scene unusable, the
            preset lets light or viewer into the colours or density be 0, or a camera is inside the
            performer's band.
    """
    preset = run.model.field.preset
    for key in ("direction_octaves", "normal_octaves"):
        if getattr(preset, key) >= 0:
            raise InputError(f"preset option {key}", str(getattr(preset, key)),
                             f"-1 with --integrator {options.integrator}",
                             "Colours that depend on it contain the light of the capture and cannot be "
                             "relit.")
    if preset.density_activation == "relu":
        raise InputError("preset option density_activation", "relu",
                         f"softplus with --integrator {options.integrator}",
                         "Gradients through scattering are biased where the density is 0, so it would stay 0 "
                         "there.")
    entries = lights(capture.known_lighting())
    train = capture.splits["train"]
    for name in train.cameras:
        for frame in train.frames:
            expect_outside(run, capture.cameras[name], frame, options.cell)
    return entries


class ScatteringStep:
    """Paths through the field as a scattering medium, replayed for gradients.

    The field is evaluated once on a grid, by batched networks. Paths are traced there, and replayed for
    gradients in the grid's nodes, which continue through the networks as a vector-Jacobian product. The grid
    is shifted by a random part of a cell in each step, so that no detail can hide between nodes. The opacity
    and edge terms of the loss come from quadrature along the same rays.

    Args:
        run: the body and the networks' architecture; its parameters are not used.
        frames: all frames that batches can have.
        lights: entries of a scene's dictionary.
        options: sampling and loss.
        quadrature: computes the loss's terms in the density alone.
        refinement: applies corrections, which get no gradient here. The run's poses must have them.
    """

    def __init__(self, run: Run, frames: Sequence[int], lights: dict[str, Any], options: TrainingOptions,
                 quadrature: QuadratureStep, refinement: Refinement | None = None) -> None:
        self._run = run
        self._paths = options.paths
        self._quadrature = quadrature
        self._refinement = refinement
        self._loss = NoisyLoss(options.paths)
        self._scene = ScatteringScene(run, frames, lights, options.cell)
        integrator = mi.load_dict(
            {"type": options.integrator, "max_depth": options.max_depth, "hide_emitters": True})
        background = srgb_to_linear(mi.Color3f(*(float(v) for v in run.background)))
        self._replay = Replay(self._scene.scene, integrator, background)

    def __call__(self, parameters: FieldParameters, batch: Batch, corrections: Corrections = NONE
                 ) -> tuple[mi.Float, Statistics]:
        paths = batch.paths
        if paths is None:
            raise ValueError("a step through scattering needs a batch with path seeds")
        if self._refinement is not None and corrections.groups():
            batch = self._refinement.frozen(corrections, batch)
        density_terms, radiance, _ = self._quadrature.density_terms(parameters, batch)
        frame = batch.frame
        # Without an occupancy: all nodes in the band are evaluated.
        posed = PosedModel(self._run.model, parameters, self._run.surface(frame), mi.Float(batch.pose))
        baked, nodes = self._scene.place(posed, frame, paths.shift)
        ray = repeated(batch.ray, self._paths)
        colours = self._replay.radiance(ray, paths.seed)
        error, adjoint = self._loss(colours, mi.Color3f(batch.target))
        self._replay.backward(ray, paths.seed, colours, adjoint)
        # Has the value of the error, and its gradients by way of the nodes.
        vjp = baked.vjp(dr.grad(nodes))
        return density_terms + (error + vjp - dr.detach(vjp)), statistics(radiance, posed, error)
