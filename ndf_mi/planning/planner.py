"""Plans a model: reads a capture's training images and decides which parts of the full model they need."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import Preset, preset
from ndf_mi.planning import findings as about
from ndf_mi.planning.appearance import Appearance
from ndf_mi.planning.bands import place_bands
from ndf_mi.planning.detail import detail
from ndf_mi.planning.observations import chosen_frames, observe
from ndf_mi.planning.plan import Finding, Plan, PlanSettings
from ndf_mi.planning.standoff import standoff

STEPS = ("images", "light", "view", "pose", "silhouettes", "detail")
"""The steps of :func:`plan`, in order."""


def full_model() -> Preset:
    """The full model that plans start from: `fast` plus the mirrored view direction."""
    return dataclasses.replace(preset("fast"), name="full", direction_octaves=2, direction="mirrored")


def plan(capture: Capture, settings: PlanSettings = PlanSettings(),  # noqa: B008
         progress: Callable[[str], None] = lambda step: None, residual: np.ndarray | None = None,
         least: float = 0.0) -> Plan:
    """The plan for a capture, from its training cameras and frames alone.

    Args:
        capture: the capture, with the surface that the field will be wrapped around as its body.
        settings: how much a part must be worth, and how many images are read.
        progress: called with each of :data:`STEPS` when it begins.
        residual: (V,) metres by which the surface is known to be off at each vertex.
        least: metres that the performer may stand off the surface where no mask shows it.

    Raises:
        InputError: an image cannot be read, or none shows the body within the mask.
    """
    full = _full(settings)
    frames = chosen_frames(capture, settings.frames)
    progress("images")
    observations, views = observe(capture, frames)
    appearance = Appearance(observations, settings.seed)
    progress("light")
    light = about.about_light(appearance.normal(), settings, full)
    given_normal = light.changes["normal_octaves"] >= 0
    progress("view")
    view = about.about_view(appearance.view(given_normal), settings, full)
    progress("pose")
    body, poses = capture.body, capture.poses
    rest = _rest(capture)
    measured = detail(body, rest, observations, views)
    moved = about.articulation(poses, [poses.index(frame) for frame in capture.splits["train"].frames])
    pose = about.about_pose(moved, *appearance.frame(given_normal), measured, settings, full)
    progress("silhouettes")
    disagreement = standoff(capture, frames, views)
    local = place_bands(rest, body.faces, disagreement, settings.allowed_error, measured.footprint / 2, full,
                        residual)
    band = about.about_band(disagreement, measured, settings, full, local, least)
    progress("detail")
    fine = about.about_detail(measured, settings, full)
    scattering = about.about_scattering(None if capture.lighting is None else capture.lighting.name)
    found: list[Finding] = [pose, light, view, band, fine, scattering]
    changes = {key: value for finding in found for key, value in finding.changes.items()}
    colour = about.about_colour(changes, full)
    if colour is not None:
        found.append(colour)
        changes |= colour.changes
    return Plan(
        {"name": capture.name, "digest": capture.digest},
        {"cameras": list(capture.splits["train"].cameras), "frames": list(frames)},
        settings, tuple(found), dataclasses.replace(full, name="planned", **changes),
        bands=_within(local, changes["band"], changes["band_inside"]))


def local_bands(capture: Capture, preset: Preset, settings: PlanSettings,
                residual: np.ndarray | None = None) -> np.ndarray:
    """(V, 2) float32 metres, what the band needs outside and inside at each vertex, at most the preset's.

    Args:
        capture, settings, residual: as for :func:`plan`.
        preset: planned before.

    Raises:
        InputError: as :func:`plan`.
    """
    frames = chosen_frames(capture, settings.frames)
    observations, views = observe(capture, frames)
    measured = detail(capture.body, _rest(capture), observations, views)
    local = place_bands(_rest(capture), capture.body.faces, standoff(capture, frames, views),
                        settings.allowed_error, measured.footprint / 2, _full(settings), residual)
    return _within(local, preset.band, preset.band_inside)


def _full(settings: PlanSettings) -> Preset:
    """The full model, with the settings' density limit."""
    full = full_model()
    return dataclasses.replace(full, density_limit=min(full.density_limit, settings.density_limit))


def _rest(capture: Capture) -> np.ndarray:
    """(V, 3) float64 the body at rest, or without a template in its first pose, metres."""
    template = capture.body.template
    return np.asarray(capture.poses.vertices[0] if template is None else template, dtype=np.float64)


def _within(local: np.ndarray, band: float, inside: float) -> np.ndarray:
    return np.minimum(local, np.array([band, inside], np.float32))


def put_back(planned: Plan, key: str) -> Preset:
    """The planned preset with everything that one finding removed.

    Args:
        planned: the plan.
        key: of the finding. Restoring an input of the colour restores the colour network too, which is only
            removed when the colour has no inputs.

    Raises:
        InputError: the plan has no such finding.
    """
    keys = [finding.key for finding in planned.findings]
    if key not in keys:
        raise InputError("the part put back", repr(key), "one of " + ", ".join(keys))
    full = full_model()
    changes = {name: value for finding in planned.findings if finding.key not in (key, "colour")
               for name, value in finding.changes.items()}
    inputs = {name: getattr(full, name)
              for name in ("pose_layers", "direction_octaves", "normal_octaves")} | changes
    colour = None if key == "colour" else about.about_colour(inputs, full)
    changes |= {} if colour is None else colour.changes
    return dataclasses.replace(full, name=f"planned, with {key}", **changes)
