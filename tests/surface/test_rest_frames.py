"""Offsets in frames that move with the skin."""

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
from ndf_mi.surface.rest_frames import RestFrames


def icosphere(subdivisions: int = 4) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)


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
        "joints": np.array([[0, -1.0, 0], [0, 0.1, 0]]), "joint_names": ("root", "top"),
        "parents": np.array([-1, 0]),
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
    assert (rest.vjp(0, gradient) * offsets).sum() == pytest.approx((gradient * moved).sum(), abs=1e-4)


def test_offsets_of_a_body_without_model_turn_with_its_surface():
    vertices, faces = icosphere(2)
    body = Body(faces=faces, uv=np.zeros((1, 2)), uv_faces=0 * faces)
    turn = Rotation.from_rotvec([0.4, 1.1, -2.0]).as_matrix()
    poses = poses_of(np.stack([vertices, vertices @ turn.T + [1, 0, 2]]), np.zeros((2, 1, 3)))
    rest = RestFrames(capture_of(body, poses))
    offsets = 0.05 * np.random.default_rng(3).normal(size=vertices.shape)
    np.testing.assert_allclose(rest.posed(0, offsets), vertices + offsets, atol=1e-6)
    np.testing.assert_allclose(rest.posed(1, offsets), (vertices + offsets) @ turn.T + [1, 0, 2], atol=2e-6)
