"""Outlines of spheres: closed forms of the distances, and fits to masks from far away."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ndf_mi.surface.degenerate import degenerate_triangles
from ndf_mi.surface.outline_fit import OutlineFit, Outlines, sampled
from ndf_mi.surface.outline_views import OutlineViews
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.smoothing import vertex_areas

RADIUS = 0.5


def disc(camera, radius: float, shift: float = 0.0) -> np.ndarray:
    """The matte of a sphere around the camera's aim, shifted in pixels to the right; edges one pixel wide."""
    distance = np.linalg.norm(camera.position)
    pixels = camera.fl_x * radius / np.sqrt(distance**2 - radius**2)
    y, x = np.mgrid[0 : camera.h, 0 : camera.w] + 0.5
    middle = camera.project(np.zeros((1, 3)))[0]
    return np.clip(pixels - np.hypot(x - middle[0] - shift, y - middle[1]) + 0.5, 0, 1).astype(np.float32)


@pytest.fixture
def large_camera(capture):
    camera = capture.cameras["c0"]
    return dataclasses.replace(camera.scaled(192, 192), name="large")


def outlines(capture, camera, matte):
    fit = OutlineFit(RestFrames(capture), capture.body.faces, 0)
    return fit.measure({capture.splits["train"].frames[0]: [(camera, matte)]})


@pytest.mark.parametrize("radius", [0.44, 0.5, 0.56])
def test_distances_to_the_outline_of_a_sphere(capture, large_camera, radius):
    found = outlines(capture, large_camera, disc(large_camera, radius))
    there = found.weight > 0
    # The sphere is off the camera's axis by nothing, so every point moves by the same distance; the mesh's
    # own outline lies up to 4 mm within the sphere's.
    distance = np.linalg.norm(found.move[there], axis=1) / found.weight[there]
    tangent = np.sqrt(1 - (RADIUS / np.linalg.norm(large_camera.position)) ** 2)
    grown = abs(radius - RADIUS) * (radius + RADIUS) / (2 * RADIUS) / tangent
    assert np.median(distance) == pytest.approx(grown, abs=6e-3)
    outward = (found.move[there] * capture.body.template[there]).sum(1)
    if radius != RADIUS:
        assert (np.sign(outward) == np.sign(radius - RADIUS)).mean() > 0.99
    # Each metre of outline is counted once: the sphere's contour has the length 2πR·sin, seen from the side.
    assert found.weight.sum() == pytest.approx(2 * np.pi * RADIUS * tangent, rel=0.05)
    np.testing.assert_allclose(found.seen, found.weight)
    rms = np.sqrt(found.squared.sum() / found.seen.sum())
    assert rms == pytest.approx(grown, abs=7e-3)


def test_a_surface_off_its_mask_counts_and_does_not_move(capture, large_camera):
    found = outlines(capture, large_camera, np.zeros((192, 192), np.float32))
    assert found.weight.sum() == 0 and found.seen.sum() > 1
    assert np.sqrt(found.squared.sum() / found.seen.sum()) > 0.1


def test_finds_a_sphere_of_twice_the_radius(shrunk_capture):
    cameras = [shrunk_capture.cameras[name] for name in ("c0", "c1", "c2", "c3")]
    shrunk = shrunk_capture.poses.vertices[:1] * 0.5
    poses = dataclasses.replace(shrunk_capture.poses, vertices=np.repeat(shrunk, 3, axis=0))
    changed = shrunk_capture.with_body(shrunk_capture.body, poses)
    rest = RestFrames(changed)
    fit = OutlineFit(rest, changed.body.faces, 0)
    views = {2: [(camera, disc(camera, 0.45)) for camera in cameras]}
    for length in np.geomspace(0.3, 0.1, 14):
        fit.step(views, length)
    radius = np.linalg.norm(rest.vertices + fit.offsets, axis=1)
    assert np.median(radius) == pytest.approx(0.45, abs=0.02)
    agreement, residual = fit.check(views)
    assert agreement == fit.agreement(views) > 0.95
    assert not degenerate_triangles(rest.vertices, fit.offsets, changed.body.faces).any()
    assert residual.shape == radius.shape and residual.max() < 0.04


def test_the_fit_repeats(shrunk_capture):
    results = []
    for seed in (0, 0, 1):
        fit = OutlineFit(RestFrames(shrunk_capture), shrunk_capture.body.faces, seed)
        fit.step(OutlineViews(shrunk_capture, seed).next(), 0.1)
        results.append(fit.offsets)
    np.testing.assert_array_equal(results[0], results[1])
    assert np.abs(results[0] - results[2]).max() > 1e-6


def test_samples_are_bilinear_between_pixels_centres():
    image = np.float32([[0, 1], [2, 3]])
    np.testing.assert_allclose(sampled(image, np.array([[0.5, 0.5], [1.0, 1.0], [1.5, 0.75]])), [0, 1.5, 1.5])
    assert sampled(image, np.array([[-3.0, 0.5]])) == 0


def test_degenerate_triangles_hold_back_their_surroundings_alone(capture):
    # Updates of 20 cm outwards everywhere, and at one vertex far inwards: its triangles would turn over.
    class Pushed(OutlineFit):
        def measure(self, views, collected=None):
            weight = vertex_areas(rest.vertices, faces)
            outwards = 0.2 * rest.vertices / np.linalg.norm(rest.vertices, axis=1, keepdims=True)
            outwards[spike] = -200 * rest.vertices[spike]
            return Outlines(weight, weight[:, None] * outwards, weight, weight)

    rest, faces, spike = RestFrames(capture), capture.body.faces, 400
    fit = Pushed(rest, faces, 0)
    fit.step({}, 0.05)
    assert not degenerate_triangles(rest.vertices, fit.offsets, faces).any()
    moved = np.linalg.norm(fit.offsets, axis=1)
    far = np.linalg.norm(rest.vertices - rest.vertices[spike], axis=1) > 0.5
    assert moved[spike] < 0.02
    # Over-relaxation makes it half as much again.
    assert np.median(moved[far]) == pytest.approx(0.3, rel=0.05) and moved[far].min() > 0.2
