"""Gradients of images through moving contours: closed forms and finite differences."""

from __future__ import annotations

from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import Camera
from ndf_mi.surface.contours import Contours, contour_gradient
from ndf_mi.surface.textured import TexturedSurface

SIZE, FOCAL, DISTANCE, RADIUS = 48, 72.0, 2.2, 0.5
WHOLE = (0, 0, SIZE, SIZE)


def camera() -> Camera:
    """At `DISTANCE` on the z axis, looking at the origin."""
    transform = np.eye(4)
    transform[2, 3] = DISTANCE
    return Camera("c", SIZE, SIZE, FOCAL, FOCAL, SIZE / 2, SIZE / 2, transform)


def capture_of(meshes: list[trimesh.Trimesh]) -> SimpleNamespace:
    """A body of spheres, each with its own colour in the texture (2, 2)."""
    joined = trimesh.util.concatenate(meshes)
    faces = np.asarray(joined.faces, np.int32)
    vertices = np.asarray(joined.vertices, np.float32)
    which = np.concatenate([np.full(len(mesh.faces), index) for index, mesh in enumerate(meshes)])
    uv_faces = np.repeat(which[:, None], 3, axis=1).astype(np.int32)
    uv = np.array([[0.0, 1.0], [1.0, 0.0]])[: len(meshes)]
    zeros = np.zeros((1, 3))
    poses = Poses(np.arange(1), vertices[None], np.zeros((1, 1, 3)), zeros, zeros)
    return SimpleNamespace(
        body=Body(faces=faces, uv=uv, uv_faces=uv_faces), poses=poses, background=np.array([0.2, 0.6, 0.4])
    )


def texture() -> mi.TensorXf:
    return mi.TensorXf(
        np.array([[[0.9, 0.1, 0.2], [0, 0, 0]], [[0, 0, 0], [0.1, 0.3, 0.8]]], dtype=np.float32)
    )


def test_covered_area_of_a_sphere():
    # A sphere on the optical axis covers π f² R² / (D² - R²) square pixels.
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    vertices = np.asarray(mesh.vertices)
    surface = TexturedSurface(capture_of([mesh]), 2)
    surface.set_vertices(mi.Float(vertices.astype(np.float32).ravel()))
    adjoint = np.zeros((SIZE, SIZE, 4), dtype=np.float32)
    adjoint[..., 3] = 1
    samples = Contours(mesh.faces).sample(vertices, camera(), 4096, np.random.default_rng(0))
    radius = FOCAL * RADIUS / np.sqrt(DISTANCE**2 - RADIUS**2)
    assert 4096 * samples.length == pytest.approx(2 * np.pi * radius, rel=0.02)
    gradient = contour_gradient(surface, vertices, camera(), samples, mi.TensorXf(adjoint), WHOLE)
    expected = 2 * np.pi * FOCAL**2 * RADIUS * DISTANCE**2 / (DISTANCE**2 - RADIUS**2) ** 2
    assert (gradient * vertices).sum() / RADIUS == pytest.approx(expected, rel=0.02)


def test_contours_of_a_cube():
    mesh = trimesh.creation.box(extents=(1, 1, 1))
    contours = Contours(np.asarray(mesh.faces))
    # From the axis the camera sees the front face alone: its four sides are the contour.
    assert len(contours.edges(np.asarray(mesh.vertices), camera())) == 4
    opened = Contours(np.asarray(mesh.faces)[1:])
    assert len(opened.edges(np.asarray(mesh.vertices), camera())) >= 3


def test_gradient_of_an_image_against_finite_differences():
    # A small sphere in front of a large one: contours against the background and against the body.
    meshes = [trimesh.creation.icosphere(subdivisions=3, radius=r) for r in (RADIUS, 0.2)]
    meshes[1].apply_translation([0.3, 0.1, 0.8])
    capture = capture_of(meshes)
    surface = TexturedSurface(capture, 2)
    surface.set_texture(texture())
    rest = capture.poses.vertices[0].astype(np.float64)
    moving = np.arange(len(rest)) >= len(meshes[0].vertices)
    direction = np.where(moving[:, None], [0.7, -0.5, 0.3], 0.2 * rest)
    x, y = np.meshgrid(np.linspace(0, 1, SIZE), np.linspace(0, 1, SIZE))
    weights = np.stack([x, y * x, 1 - y, x - 0.3], axis=-1).astype(np.float32)

    def loss(step: float) -> float:
        surface.set_vertices(mi.Float((rest + step * direction).astype(np.float32).ravel()))
        images = [surface.layers(camera(), 400, seed).numpy() for seed in range(16)]
        return float((weights * np.mean(images, axis=0, dtype=np.float64)).sum())

    step = 0.005
    expected = (loss(step) - loss(-step)) / (2 * step)

    vertices = mi.Float(rest.astype(np.float32).ravel())
    dr.enable_grad(vertices)
    surface.set_vertices(vertices)
    dr.backward(dr.sum(surface.layers(camera(), 64, 3).array * mi.TensorXf(weights).array))
    inner = vertices.grad.numpy().reshape(-1, 3)
    samples = Contours(capture.body.faces).sample(rest, camera(), 20_000, np.random.default_rng(1))
    outer = contour_gradient(surface, rest, camera(), samples, mi.TensorXf(weights), WHOLE)
    assert ((inner + outer) * direction).sum() == pytest.approx(expected, rel=0.015)
    assert abs((outer * direction).sum()) > 0.5 * abs(expected)
