"""Smoothing, repairing and moving of offsets against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import SkinnedVertices, joint_transforms
from ndf_mi.capture.document import Split
from ndf_mi.surface.degenerate import repair, shapes, unsound
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.smoothing import SmoothOffsets, cotangent_stiffness, vertex_areas


def icosphere(subdivisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)


def grid(count: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """A square of side 1 in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], axis=1)
    a = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + count, a + count + 1], 1), np.stack([a, a + count + 1, a + 1], 1)])
    return vertices, faces.astype(np.int32)


def test_areas_are_the_surface():
    vertices, faces = grid()
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


def test_shapes():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 1, 0], [2, 0, 0]])
    expected = [1, np.sqrt(3) / 2, 0]
    np.testing.assert_allclose(shapes(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])), expected, atol=1e-12)


def test_mending_unfolds_what_is_folded_and_nothing_else():
    vertices, faces = grid()
    offsets = np.zeros_like(vertices)
    offsets[:, 2] = 0.2 * vertices[:, 0]
    np.testing.assert_array_equal(repair(vertices, offsets, faces), offsets)
    offsets[40, :2] += [0.3, 0.1]
    assert unsound(vertices, offsets, faces).any()
    repaired = repair(vertices, offsets, faces)
    assert not unsound(vertices, repaired, faces).any()
    far = np.abs(vertices - vertices[40]).max(axis=1) > 0.45
    np.testing.assert_array_equal(repaired[far], offsets[far])


def test_mending_goes_back_to_what_was_sound_and_no_further():
    """A slope that was there before a fold stays in the fold's place."""
    vertices, faces = grid()
    sound = np.zeros_like(vertices)
    sound[:, 2] = 0.2 * vertices[:, 0]
    offsets = sound + [0.0, 0.0, 0.01]
    offsets[40, :2] += [0.3, 0.1]
    repaired = repair(vertices, offsets, faces, sound)
    assert not unsound(vertices, repaired, faces).any()
    assert np.abs(repaired - sound).max() < 0.011 and (repaired[40] == sound[40]).all()
    # Where nothing can be kept, everything goes back.
    np.testing.assert_array_equal(repair(vertices, vertices * [-2.0, 0.0, 0.0], faces, sound), sound)


def capture_of(body: Body, poses: Poses) -> SimpleNamespace:
    return SimpleNamespace(body=body, poses=poses, splits={"train": Split(("c",), (0,))})


def poses_of(vertices: np.ndarray, pose: np.ndarray, **fields: np.ndarray) -> Poses:
    count = len(vertices)
    zeros = np.zeros((count, 3))
    return Poses(np.arange(count), vertices, pose, **{"root_rotation": zeros, "translation": zeros, **fields})


def test_offsets_move_like_the_skin():
    vertices, faces = icosphere(2)
    random = np.random.default_rng(2)
    share = np.clip(0.5 + vertices[:, 1], 0, 1)
    model = {
        "joints": np.array([[0, -1.0, 0], [0, 0.1, 0]]), "joint_names": ("root", "top"), "parents": np.array([-1, 0]),
        "weights": np.stack([1 - share, share], 1), "shape_dirs": random.normal(size=(*vertices.shape, 2)),
    }  # fmt: skip
    uv = np.zeros((1, 2))
    pose = np.array([[[0, 0, 0], [0.3, -0.8, 0.5]]])
    root, move, shape = np.array([[0.2, 1.5, -0.4]]), np.array([[0.1, 0.2, 0.3]]), np.array([0.02, -0.03])
    offsets = 0.05 * random.normal(size=vertices.shape)

    def posed(template: np.ndarray) -> np.ndarray:
        body = Body(faces=faces, uv=uv, uv_faces=0 * faces, template=template, **model)
        skinned = SkinnedVertices(body.template, body.weights, body.shape_dirs)
        moved = joint_transforms(body, pose[0], root[0], move[0], shape)
        return skinned.apply(moved).numpy().reshape(-1, 3)

    body = Body(faces=faces, uv=uv, uv_faces=0 * faces, template=vertices, **model)
    poses = poses_of(posed(vertices)[None], pose, root_rotation=root, translation=move, shape=shape)
    rest = RestFrames(capture_of(body, poses))
    np.testing.assert_allclose(rest.posed(0, offsets), posed(vertices + offsets), atol=2e-6)
    np.testing.assert_allclose(rest.vertices, vertices + model["shape_dirs"] @ shape, atol=1e-6)
    gradient = random.normal(size=vertices.shape)
    moved = rest.posed(0, offsets) - rest.posed(0, 0 * offsets)
    assert (rest.pull_back(0, gradient) * offsets).sum() == pytest.approx((gradient * moved).sum(), abs=1e-4)


def test_offsets_of_a_body_without_model_turn_with_its_surface():
    vertices, faces = icosphere(2)
    body = Body(faces=faces, uv=np.zeros((1, 2)), uv_faces=0 * faces)
    turn = Rotation.from_rotvec([0.4, 1.1, -2.0]).as_matrix()
    poses = poses_of(np.stack([vertices, vertices @ turn.T + [1, 0, 2]]), np.zeros((2, 1, 3)))
    rest = RestFrames(capture_of(body, poses))
    offsets = 0.05 * np.random.default_rng(3).normal(size=vertices.shape)
    np.testing.assert_allclose(rest.posed(0, offsets), vertices + offsets, atol=1e-6)
    np.testing.assert_allclose(rest.posed(1, offsets), (vertices + offsets) @ turn.T + [1, 0, 2], atol=2e-6)
