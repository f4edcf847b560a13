"""The reference surface of spheres that are larger than the body, and of bodies with pose blend shapes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sphere_capture import with_body

from ndf_mi.body.skinning import skin
from ndf_mi.capture.capture import Capture
from ndf_mi.surface.reference import fit_reference, with_offsets
from ndf_mi.surface.rest_frames import RestFrames


def test_finds_the_sphere(shrunk_capture):
    found = fit_reference(shrunk_capture)
    radius = np.linalg.norm(shrunk_capture.body.template + found.offsets, axis=1)
    assert np.median(radius) == pytest.approx(0.5, abs=0.01)
    assert found.agreement > 0.96
    assert found.body is shrunk_capture.body
    for row, shift in enumerate(found.poses.translation):
        np.testing.assert_allclose(found.poses.vertices[row] - shift,
                                   shrunk_capture.body.template + found.offsets, atol=0.02)


def skinned_capture(capture: Capture) -> Capture:
    """The sphere on two joints, bent and turned in each frame, with pose and shape blend shapes."""
    random = np.random.default_rng(0)
    template = capture.body.template
    upper = np.clip(0.5 + template[:, 1], 0, 1)
    body = dataclasses.replace(
        capture.body, joints=np.float32([[0, -0.3, 0], [0, 0.1, 0]]), joint_names=("root", "top"),
        parents=np.int32([-1, 0]), weights=np.stack([1 - upper, upper], axis=1).astype(np.float32),
        shape_dirs=random.normal(0, 0.02, (len(template), 3, 2)).astype(np.float32),
        pose_dirs=random.normal(0, 0.02, (len(template), 3, 9)).astype(np.float32),
        joint_dirs=random.normal(0, 0.02, (2, 3, 2)).astype(np.float32),
    )
    pose = np.zeros((3, 2, 3), np.float32)
    pose[:, 1] = random.normal(0, 0.4, (3, 3))
    turned = random.normal(0, 0.5, (3, 3)).astype(np.float32)
    shape = np.float32([0.5, -1.0])
    posed = [skin(body, pose[i], turned[i], capture.poses.translation[i], shape).numpy().reshape(-1, 3)
             for i in range(3)]
    poses = dataclasses.replace(capture.poses, vertices=np.stack(posed), pose=pose, root_rotation=turned,
                                shape=shape)
    return with_body(capture, body, poses)


def test_skinning_the_new_body_gives_the_new_poses(capture):
    changed = skinned_capture(capture)
    offsets = np.random.default_rng(1).normal(0, 0.1, changed.body.template.shape).astype(np.float32)
    body, poses = with_offsets(changed, RestFrames(changed), offsets)
    np.testing.assert_array_equal(body.template, changed.body.template + offsets)
    assert np.abs(poses.vertices - changed.poses.vertices).max() > 0.1
    for row in range(3):
        found = skin(body, poses.pose[row], poses.root_rotation[row], poses.translation[row], poses.shape)
        np.testing.assert_allclose(poses.vertices[row].ravel(), found.numpy(), atol=2e-6)
