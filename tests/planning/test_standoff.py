"""Stand-off from masks and bodies."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.field import preset
from ndf_mi.planning.bands import place_bands
from ndf_mi.planning.observations import chosen_frames, observe
from ndf_mi.planning.standoff import Disagreement, standoff


def scaled(capture: Capture, factor: float) -> Capture:
    """The same images with a body of another size."""
    other = Capture.read(capture.path)
    middle = other.poses.vertices.mean(axis=1, keepdims=True)
    poses = {field.name: getattr(other.poses, field.name) for field in dataclasses.fields(Poses)}
    other.poses = Poses(**(poses | {"vertices": middle + factor * (other.poses.vertices - middle)}))
    return other


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.08])
def test_the_stand_off_is_measured_to_a_pixel(capture: Capture, factor: float) -> None:
    other = scaled(capture, factor)
    frames = chosen_frames(other, 24)
    seen, views = observe(other, frames)
    found = standoff(other, frames, views)
    truth, pixel = 0.5 * (1 - factor), float(np.median(seen.footprint))
    assert found.outside.reach(0) == pytest.approx(max(truth, 0), abs=pixel)
    assert found.inside.reach(0) == pytest.approx(max(-truth, 0), abs=pixel)
    # Every disagreeing pixel has its place, and the band there is wide enough.
    part = found.outside if truth > 0 else found.inside
    assert (part.triangle >= 0).all() and (part.triangle < len(other.body.faces)).all()
    widths = place_bands(other.poses.vertices[0], other.body.faces, found, 0.0, pixel / 2, preset("fast"))
    needed = [(max(truth, pixel / 2) + pixel / 2) / 0.8, max(-truth, 0) + pixel / 2]
    assert (widths.max(0) > np.array(needed) - pixel).all() and widths[:, 0].max() < 2 * needed[0] + 0.05


def test_distant_pixels_that_cost_little_are_ignored() -> None:
    pixels = Disagreement(np.array([0.05, 0.01, 0.02, 0.01]), np.array([0.1, 0.5, 0.2, 0.5]),
                          np.zeros(4, int))
    assert [pixels.reach(allowed) for allowed in (0.0, 0.15, 0.3, 0.35, 2.0)] == [0.05, 0.02, 0.02, 0.01, 0.0]
