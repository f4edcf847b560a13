"""Looks at a capture's training images and says which model they need."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import Preset, preset
from ndf_mi.planning import findings as about
from ndf_mi.planning.appearance import Appearance
from ndf_mi.planning.detail import detail
from ndf_mi.planning.observations import chosen_frames, observe
from ndf_mi.planning.plan import Finding, Plan, Settings
from ndf_mi.planning.standoff import standoff

STAGES = ("images", "light", "view", "pose", "silhouettes", "detail")
"""What :func:`plan` does, one after the other."""


def full_model() -> Preset:
    """The model that nothing is left out of: `fast`, with the mirrored view direction, which it leaves to glossy performers."""
    return dataclasses.replace(preset("fast"), name="full", direction_octaves=2, direction="mirrored")


def plan(capture: Capture, settings: Settings = Settings(), stage: Callable[[str], None] = lambda name: None) -> Plan:  # noqa: B008
    """The plan for a capture, from its training cameras and frames alone.

    Args:
        capture: the capture.
        settings: what parts have to be worth, and how much is looked at.
        stage: told each of :data:`STAGES` when it begins.

    Raises:
        InputError: an image cannot be read, or none shows the body within the mask.
    """
    full = full_model()
    frames = chosen_frames(capture, settings.frames)
    stage("images")
    seen, views = observe(capture, frames)
    appearance = Appearance(seen, settings.seed)
    stage("light")
    light = about.about_light(appearance.normal(), settings, full)
    given = light.changes["normal_octaves"] >= 0
    stage("view")
    view = about.about_view(appearance.view(given), settings, full)
    stage("pose")
    body, poses = capture.body, capture.poses
    sizes = detail(body, np.asarray(poses.vertices[0] if body.template is None else body.template, dtype=np.float64), seen, views)
    moved = about.articulation(poses, [poses.index(frame) for frame in capture.splits["train"].frames])
    pose = about.about_pose(moved, *appearance.frame(given), sizes, settings, full)
    stage("silhouettes")
    band = about.about_band(standoff(capture, frames, views), sizes, settings, full)
    stage("detail")
    fine = about.about_detail(sizes, settings, full)
    scattering = about.about_scattering(None if capture.lighting is None else capture.lighting.name)
    found: list[Finding] = [pose, light, view, band, fine, scattering]
    changes = {key: value for finding in found for key, value in finding.changes.items()}
    alone = about.colour_alone(changes, full)
    if alone is not None:
        found.append(alone)
        changes |= alone.changes
    return Plan(
        {"name": capture.name, "digest": capture.digest},
        {"cameras": list(capture.splits["train"].cameras), "frames": list(frames)},
        settings, tuple(found), dataclasses.replace(full, name="planned", **changes))


def put_back(found: Plan, key: str) -> Preset:
    """What was planned, with all that one finding took away: the preset where that finding had found everything needed.

    Args:
        found: the plan.
        key: of the finding. What enters the colour takes the colour network with it: only without any of it that network goes.

    Raises:
        InputError: the plan has no such finding.
    """
    keys = [finding.key for finding in found.findings]
    if key not in keys:
        raise InputError("the part put back", repr(key), "one of " + ", ".join(keys))
    full = full_model()
    changes = {name: value for finding in found.findings if finding.key not in (key, "colour")
               for name, value in finding.changes.items()}
    entering = {name: getattr(full, name) for name in ("pose_layers", "direction_octaves", "normal_octaves")} | changes
    alone = None if key == "colour" else about.colour_alone(entering, full)
    return dataclasses.replace(full, name=f"planned, with {key}", **(changes | ({} if alone is None else alone.changes)))
