"""Smoothing of offsets against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ndf_mi.surface.smoothing import SmoothOffsets, cotangent_stiffness, vertex_areas


def icosphere(subdivisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)


def square(count: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """A square of side 1 in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], axis=1)
    a = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + count, a + count + 1], 1), np.stack([a, a + count + 1, a + 1], 1)]
    )
    return vertices, faces.astype(np.int32)


def test_areas_are_the_surface():
    vertices, faces = square()
    assert vertex_areas(vertices, faces).sum() == pytest.approx(1)
    assert vertex_areas(vertices, faces)[4 * 9 + 4] == pytest.approx(1 / 64)


def test_dirichlet_energy_of_coordinates():
    # On the unit sphere |∇x|² = 1 - x², whose integral is 8π/3.
    vertices, faces = icosphere()
    stiffness = cotangent_stiffness(vertices, faces)
    x = vertices[:, 0]
    assert x @ stiffness @ x == pytest.approx(8 * np.pi / 3, rel=5e-3)
    np.testing.assert_allclose(stiffness @ np.ones(len(x)), 0, atol=1e-12)


def test_a_step_is_damped_by_the_wavelength():
    # x is an eigenfunction of the sphere's Laplacian, of eigenvalue 2: smoothing by h divides it by 1 + 2h².
    vertices, faces = icosphere()
    smooth = SmoothOffsets(vertices, faces)
    smooth.set_length(0.7)
    gradient = vertex_areas(vertices, faces)[:, None] * vertices[:, :1] * [0, 1, 0]
    smooth.step(gradient, 0.01)
    expected = -0.01 / (1 + 2 * 0.7**2) * vertices[:, 0] / np.abs(vertices[:, 0]).max()
    np.testing.assert_allclose(smooth.offsets[:, 1], expected, atol=2e-5)
    np.testing.assert_allclose(smooth.offsets[:, [0, 2]], 0, atol=1e-15)


def test_changing_the_length_keeps_the_offsets():
    vertices, faces = icosphere(2)
    smooth = SmoothOffsets(vertices, faces)
    offsets = 0.1 * np.random.default_rng(0).normal(size=vertices.shape)
    smooth.replace(offsets)
    smooth.set_length(0.3)
    smooth.step(np.zeros_like(offsets), 0.01)
    np.testing.assert_array_equal(smooth.offsets, offsets)
    smooth.step(np.ones_like(offsets), 1e-9)
    np.testing.assert_allclose(smooth.offsets, offsets, atol=1e-8)


def test_strain():
    # d = a·x e_y: ∫|∇d|² = a²·8π/3, by the area 4π.
    vertices, faces = icosphere()
    smooth = SmoothOffsets(vertices, faces)
    smooth.replace(0.3 * vertices[:, :1] * [0, 1, 0])
    value, gradient = smooth.strain()
    assert value == pytest.approx(0.3**2 * 2 / 3, rel=5e-3)
    direction = np.random.default_rng(1).normal(size=vertices.shape)
    before = smooth.offsets
    ends = []
    for sign in (1, -1):
        smooth.replace(before + sign * 1e-4 * direction)
        ends.append(smooth.strain()[0])
    assert (gradient * direction).sum() == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-6)
