"""Primitives on a body: how they are spread, and that they move with it."""

from __future__ import annotations

import dataclasses

import mitsuba as mi
import numpy as np
import trimesh
from conftest import ball
from scipy.spatial.transform import Rotation

from ndf_mi.methods.gaussians.primitives import LEARNED, Rig, areas, initial, pose, rows, spread

EVEN = mi.Float([0.0] * 24)


def learned(count: int, seed: int = 0) -> dict[str, mi.Float]:
    rng = np.random.default_rng(seed)
    values = initial(count, np.array([0.5, 0.4, 0.3]), rng)
    return {name: mi.Float((value + 0.3 * rng.normal(size=value.shape)).astype(np.float32).ravel())
            for name, value in values.items()}


def test_they_are_spread_evenly_over_the_area():
    body, poses = ball()
    vertices = poses.vertices[0] * [1, 1, 3]
    binding = spread(vertices, body.faces, 0.02, np.random.default_rng(1))
    corners = vertices[body.faces[binding.triangle]]
    place = (corners * binding.barycentric[:, :, None]).sum(1)
    triangles = vertices[body.faces].astype(np.float64)
    area = areas(vertices, body.faces)
    np.testing.assert_allclose(area.sum(), trimesh.Trimesh(vertices, body.faces).area)
    assert len(binding) == round(area.sum() / 0.02**2)
    upper = triangles.mean(1)[:, 2] > 0.45
    share = area[upper].sum() / area.sum()
    assert abs((place[:, 2] > 0.45).mean() - share) < 0.02
    assert (binding.barycentric >= 0).all() and np.allclose(binding.barycentric.sum(1), 1)


def test_a_rigid_motion_of_the_body_moves_them_rigidly():
    body, poses = ball()
    turn, shift = Rotation.from_rotvec([0.4, -1.1, 0.7]), np.array([0.3, 1.0, -2.0])
    moved = poses.vertices.copy()
    moved[1] = turn.apply(poses.vertices[0]) + shift
    rig = Rig(body.faces, dataclasses.replace(poses, vertices=moved), body.template)
    binding = spread(moved[0], body.faces, 0.08, np.random.default_rng(1))
    values = learned(len(binding))
    first, second = (pose(rows(values), EVEN, rig.frames(binding, frame), 0.05, 0.001) for frame in (0, 1))
    np.testing.assert_allclose(np.array(second.centre).T, turn.apply(np.array(first.centre).T) + shift,
                               atol=1e-5)
    np.testing.assert_allclose(np.array(second.scale), np.array(first.scale))
    turned = (turn * Rotation.from_quat(np.array(first.rotation).T)).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(np.array(second.rotation).T).as_matrix(), turned, atol=1e-5)
    np.testing.assert_allclose(np.array(second.colour), np.array(first.colour))


def test_what_is_learned_is_what_is_posed():
    body, poses = ball()
    rig = Rig(body.faces, poses, body.template)
    binding = spread(poses.vertices[0], body.faces, 0.1, np.random.default_rng(1))
    count = len(binding)
    start = initial(count, np.full(3, 0.5), np.random.default_rng(0))
    values = {name: mi.Float(value.ravel()) for name, value in start.items()}
    # Along the normal by one spacing: from the ball of 0.3 m to one of 0.35 m.
    values["offset"] = mi.Float(np.repeat([0, 0, 1], count).astype(np.float32))
    light = np.zeros((3, 8), np.float32)
    light[0, 1], light[2, 1] = 1, -9
    posed = pose(rows(values), mi.Float(light.ravel()), rig.frames(binding, 0), 0.05, 0.001)
    place = np.array(posed.centre).T
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), 0.35, atol=2e-3)
    np.testing.assert_allclose(np.array(posed.scale).T, np.tile([0.031, 0.031, 0.011], (count, 1)), rtol=1e-5)
    np.testing.assert_allclose(np.array(posed.opacity), 1 / (1 + np.exp(-1)), rtol=1e-6)
    # The second harmonic of degree 1 is that of z.
    harmonic = np.sqrt(3 / (4 * np.pi)) * np.array(rig.frames(binding, 0).normal)[2]
    expected = 0.5 * np.stack([1 + harmonic, np.ones(count), 1 - 9 * harmonic])
    np.testing.assert_allclose(np.array(posed.colour), np.maximum(expected, 0), atol=1e-5)
    assert set(values) == set(LEARNED)
