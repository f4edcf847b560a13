"""What comes before the first step: the reference surface is fitted, and the model is planned on it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.agreement import check_agreement
from ndf_mi.capture.capture import Capture
from ndf_mi.field import Preset
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.refined import registered_capture
from ndf_mi.learn.registration import register
from ndf_mi.planning.plan import Plan, PlanSettings
from ndf_mi.planning.planner import local_bands, plan
from ndf_mi.surface.reference import fit_reference

SHARE, LONGEST = 0.1, 60.0
"""The surface's share of a training that ends by the clock, and its longest time in seconds."""

SLACK = 0.03
"""Metres by which the surface's offsets are shortened: what is within reach of every band needs no offset,
and offsets bend in poses that were not seen.
"""

UNSEEN = 0.05
"""Metres that the performer may stand off the surface where no outline shows it: a little more than what
`SLACK` takes off.
"""

Show = Callable[[str], None]
"""Called with what is done now, in a few words."""


@dataclass(frozen=True)
class Reference:
    """The surface that a field is wrapped around.

    Attributes:
        body, poses: the surface at rest and in every frame.
        tensors: what the run keeps of it, as in `Run.surface_tensors`.
        residual: (V,) metres by which the surface may be off, or None where nothing was fitted.
        agreement: mean intersection over union of the masks and the fitted surface's silhouettes, before
            `SLACK` was taken off; or None.
        seconds: what it took.
    """

    body: Body
    poses: Poses
    tensors: Mapping[str, np.ndarray] = field(default_factory=dict)
    residual: np.ndarray | None = None
    agreement: float | None = None
    seconds: float = 0.0

    @property
    def kind(self) -> str:
        """The training option `surface` that made it: `offset` or `body`."""
        return "offset" if "offsets" in self.tensors else "body"

    def seen_by(self, capture: Capture) -> Capture:
        """The capture with this surface in place of its body, and with its registered cameras."""
        return registered_capture(capture, self.tensors).with_body(self.body, self.poses)


@dataclass(frozen=True)
class Planned:
    """A model that was planned for a capture.

    Attributes:
        plan: the plan.
        seconds: what planning took.
    """

    plan: Plan
    seconds: float


def reference(capture: Capture, options: TrainingOptions, show: Show = lambda text: None) -> Reference:
    """The reference surface that the options ask for, around the fit that `refine` has registered to the
    outlines of the masks.

    A training that ends by the clock spends a tenth of its time on it, at most a minute, and as much on
    registering the fit before; others a fixed number of steps, so that they repeat exactly.

    Raises:
        InputError: body, masks and images do not belong together (`check_agreement`), the images do not
            show the body (`fit_reference`), or it cannot be refined (`register`).
    """
    started = time.perf_counter()
    show("comparing body, masks and images")
    check_agreement(capture)
    body = capture.body
    if options.atlas == "one-piece":
        from ndf_mi.body.atlas import with_one_piece  # needs packages that other trainings do not

        body = with_one_piece(body, capture.poses.vertices[0] if body.template is None else None)
    budget = min(SHARE * options.seconds, LONGEST) if options.seconds > 0 else None
    registered = register(capture.with_body(body, capture.poses), options, budget,
                          lambda taken: show(f"fitting body and cameras to the masks: round {taken}"))
    capture = registered.capture
    if options.surface == "body":
        return Reference(body, capture.poses, registered.tensors, seconds=time.perf_counter() - started)
    show("fitting the reference surface")
    fitted = fit_reference(capture, budget, options.seed,
                           lambda seconds, step, done: show(f"fitting the reference surface: {done:.0%}"),
                           SLACK)
    return Reference(fitted.body, fitted.poses, {"offsets": fitted.offsets, **registered.tensors},
                     fitted.residual, fitted.agreement, time.perf_counter() - started)


def planned(capture: Capture, surface: Reference, settings: PlanSettings = PlanSettings(),  # noqa: B008
            show: Show = lambda text: None) -> Planned:
    """The model that a capture needs around a reference surface.

    Raises:
        InputError: an image cannot be read, or none shows the surface within the mask.
    """
    started = time.perf_counter()
    found = plan(surface.seen_by(capture), settings, lambda step: show(f"planning the model: {step}"),
                 surface.residual, 0.0 if surface.kind == "body" else UNSEEN)
    return Planned(replace(found, surface=surface.kind), time.perf_counter() - started)


def measured_bands(capture: Capture, surface: Reference, preset: Preset, settings: PlanSettings,
                   show: Show = lambda text: None) -> tuple[np.ndarray, float]:
    """The bands of a model that was planned before, as `Plan.bands`, and the seconds that measuring took."""
    started = time.perf_counter()
    show("measuring how wide the band must be at each place")
    bands = local_bands(surface.seen_by(capture), preset, settings, surface.residual)
    return bands, time.perf_counter() - started


def with_bands(surface: Reference, bands: np.ndarray | None, planned: Preset, preset: Preset,
               options: TrainingOptions) -> Reference:
    """The surface with a band of its own at every vertex; without where the options or another band that was
    asked for make it uniform.

    Args:
        bands: of a plan.
        planned: its preset.
        preset: what will be trained.
    """
    asked = (preset.band, preset.band_inside) != (planned.band, planned.band_inside)
    if bands is None or asked or options.bands == "uniform":
        return surface
    return replace(surface, tensors={**surface.tensors, "bands": bands})


def record(surface: Reference) -> dict[str, Any]:
    """What `config.json` says of the surface."""
    if surface.agreement is None:
        return {}
    lengths = np.linalg.norm(surface.tensors["offsets"], axis=1)
    return {"surface": {"seconds": round(surface.seconds, 3), "agreement": round(surface.agreement, 4),
                        "offset_median_mm": round(1e3 * float(np.median(lengths)), 1),
                        "offset_max_mm": round(1e3 * float(lengths.max()), 1)}}
