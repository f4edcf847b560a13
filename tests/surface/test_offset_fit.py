"""The mesh with offsets on spheres: what it is given is smaller than, or another shape than, what the images show."""

from __future__ import annotations

import numpy as np
import pytest
from sphere_capture import FRAMES, draw, with_body

from ndf_mi.surface.degenerate import shapes, unsound
from ndf_mi.surface.offset_fit import OffsetFit
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.textured import TexturedSurface

RADIUS = 0.5


def fitted(capture, steps: int = 80) -> tuple[np.ndarray, OffsetFit]:
    fit = OffsetFit(TexturedSurface(capture, 32), RestFrames(capture), capture, 32, 0.05, 2e-2, 0)
    fit.for_steps(steps)
    return fit.offsets(), fit


def assert_sound(capture, offsets: np.ndarray) -> None:
    rest, faces = RestFrames(capture).vertices, capture.body.faces
    assert not unsound(rest, offsets, faces).any()
    before, after = shapes(rest, faces), shapes(rest + offsets, faces)
    assert (after > 0.5 * before).all()


def test_recovers_the_radius(shrunk_capture):
    # A pixel is 3 cm at the sphere; the training images show it from four sides.
    offsets, fit = fitted(shrunk_capture)
    found = np.linalg.norm(shrunk_capture.body.template + offsets, axis=1)
    assert found.mean() == pytest.approx(RADIUS, abs=3e-3)
    # Half a pixel: triangles that turn over on the way go back to where they were some steps before, and lose a little.
    assert np.percentile(np.abs(found - RADIUS), 90) < 0.015
    assert_sound(shrunk_capture, offsets)
    assert fit.step() < 0.002


def test_recovers_a_bump(capture):
    centre = np.array([0.0, 0.0, RADIUS])
    distance = np.linalg.norm(capture.body.template - centre, axis=1, keepdims=True)
    bump = 0.2 * np.exp(-((distance / 0.25) ** 2)) * capture.body.template
    truth = {
        (name, frame): draw(capture.body, capture.poses.vertices[index] + bump.astype(np.float32), capture.cameras[name])
        for index, frame in enumerate(FRAMES[:2])
        for name in capture.splits["train"].cameras
    }
    changed = with_body(capture, capture.body, capture.poses)
    changed.image = lambda name, frame: truth[name, frame][0]
    changed.mask = lambda name, frame: truth[name, frame][1]
    offsets, _ = fitted(changed)
    outward = (offsets * capture.body.template).sum(1) / np.linalg.norm(capture.body.template, axis=1)
    assert outward[distance[:, 0] < 0.08].mean() == pytest.approx(0.095, abs=0.02)
    assert np.abs(outward[distance[:, 0] > 0.6]).mean() < 0.006
    assert_sound(changed, offsets)


def test_same_seed_same_offsets(shrunk_capture):
    surface, rest = TexturedSurface(shrunk_capture, 16), RestFrames(shrunk_capture)
    results = []
    for seed in (3, 3, 4):
        fit = OffsetFit(surface, rest, shrunk_capture, 16, 0.05, 4e-3, seed)
        fit.for_steps(3)
        results.append(fit.offsets())
    np.testing.assert_allclose(results[0], results[1], atol=1e-5)
    assert np.abs(results[0] - results[2]).max() > 1e-4
