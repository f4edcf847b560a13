"""Corrected rays are those of the corrected camera, and their gradients those of differences."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sphere_capture import ring_camera

from ndf_mi.learn.camera_corrections import COLUMNS, CameraCorrections, corrected

CAMERAS = [ring_camera("a", 0.3), ring_camera("b", 2.0, -0.2)]


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def ray_of(cameras, pixels):
    """One ray of each camera."""
    rays = [camera.rays(mi.Point2f(*map(float, pixel)))
            for camera, pixel in zip(cameras, pixels, strict=True)]
    stack = [np.stack([np.asarray(getattr(ray, part))[:, 0] for ray in rays], 1) for part in "od"]
    return mi.Ray3f(mi.Point3f(stack[0]), mi.Vector3f(stack[1]))


def test_rays_are_those_of_the_corrected_camera(rng):
    corrections = CameraCorrections(CAMERAS)
    values = mi.Float(rng.normal(0, 2, corrections.count).astype(np.float32))
    tensors = corrections.tensors(values)
    pixels = rng.uniform(0, 48, (2, 2))
    found = corrections.rays(values, mi.UInt32(np.arange(2)), ray_of(CAMERAS, pixels))
    parts = ("camera_rotation", "camera_translation", "camera_focal")
    moved = [corrected(camera, *(tensors[part][row] for part in parts))
             for row, camera in enumerate(CAMERAS)]
    expected = ray_of(moved, pixels)
    np.testing.assert_allclose(found.o, expected.o, atol=1e-6)
    np.testing.assert_allclose(found.d, expected.d, atol=1e-6)
    assert moved[0].fl_x == pytest.approx(CAMERAS[0].fl_x * np.exp(tensors["camera_focal"][0]))
    np.testing.assert_allclose(moved[0].position - CAMERAS[0].position, tensors["camera_translation"][0])


def test_zero_corrections_change_nothing(rng):
    corrections = CameraCorrections(CAMERAS)
    ray = ray_of(CAMERAS, rng.uniform(0, 48, (2, 2)))
    found = corrections.rays(dr.zeros(mi.Float, corrections.count), mi.UInt32(np.arange(2)), ray)
    np.testing.assert_array_equal(found.o, ray.o)
    np.testing.assert_allclose(found.d, ray.d, atol=1e-7)


def closed_form(values, camera, origin, direction):
    """The ray of the class's equation in float64."""
    deviations = np.radians([0.5] * 3).tolist() + [0.01] * 4
    turn, shift, focal = np.split(values * deviations, [3, 6])
    axis = -camera.transform[:3, 2]
    along = axis * (axis @ direction)
    turned = Rotation.from_rotvec(turn).apply(along + np.exp(-focal) * (direction - along))
    return origin + shift, turned / np.linalg.norm(turned)


def test_gradients_are_those_of_differences(rng):
    corrections = CameraCorrections(CAMERAS)
    start, ray = rng.normal(0, 2, corrections.count), ray_of(CAMERAS, rng.uniform(0, 48, (2, 2)))
    weights = rng.normal(size=(2, 3, 2))
    values = mi.Float(start.astype(np.float32))
    dr.enable_grad(values)
    found = corrections.rays(values, mi.UInt32(np.arange(2)), ray)
    dr.backward(sum(dr.sum(mi.Float(weights[k, axis]) * part[axis])
                    for k, part in enumerate((found.o, found.d)) for axis in range(3)))
    origin, direction = np.asarray(ray.o, np.float64), np.asarray(ray.d, np.float64)

    def functional(values):
        rows = values.reshape(2, COLUMNS)
        parts = [closed_form(rows[i], CAMERAS[i], origin[:, i], direction[:, i]) for i in range(2)]
        return sum(weights[k, :, i] @ parts[i][k] for k in range(2) for i in range(2))

    step = 1e-5
    expected = [(functional(start + s) - functional(start - s)) / (2 * step)
                for s in step * np.eye(corrections.count)]
    np.testing.assert_allclose(dr.grad(values), expected, rtol=1e-3, atol=1e-6)
