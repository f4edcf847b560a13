"""The reference surface of spheres that are larger than the body, and of bodies with pose blend shapes."""

from __future__ import annotations

import copy
import dataclasses
import re

import numpy as np
import pytest
from sphere_capture import with_body

from ndf_mi.body.skinning import skin
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.surface.reference import ROUNDS, fit_reference, with_offsets
from ndf_mi.surface.rest_frames import RestFrames


def test_finds_the_sphere_and_repeats(shrunk_capture):
    calls = []
    found = fit_reference(shrunk_capture, progress=lambda *call: calls.append(call))
    radius = np.linalg.norm(shrunk_capture.body.template + found.offsets, axis=1)
    assert np.median(radius) == pytest.approx(0.5, abs=0.01)  # a pixel is 3 cm
    assert found.agreement > 0.96
    assert found.residual.shape == radius.shape and found.residual.max() < 0.015
    assert found.body is shrunk_capture.body
    for row, shift in enumerate(found.poses.translation):
        np.testing.assert_allclose(found.poses.vertices[row] - shift,
                                   shrunk_capture.body.template + found.offsets, atol=0.02)
    assert [call[1] for call in calls] == list(range(1, ROUNDS + 1)) and calls[-1][2] == 1
    assert found.steps == ROUNDS and found.seconds >= calls[-1][0]
    np.testing.assert_array_equal(found.offsets, fit_reference(shrunk_capture).offsets)


def test_slack_shortens_each_offset(shrunk_capture):
    whole = fit_reference(shrunk_capture)
    short = fit_reference(shrunk_capture, slack=0.03)
    long, less = (np.linalg.norm(found.offsets, axis=1) for found in (whole, short))
    np.testing.assert_allclose(less, np.maximum(long - 0.03, 0), atol=1e-6)
    assert (np.cross(whole.offsets, short.offsets) ** 2).sum() < 1e-10
    assert short.agreement == whole.agreement
    # The outlines are now off by what was taken away.
    assert np.median(short.residual) == pytest.approx(0.03, abs=0.01)
    assert not fit_reference(shrunk_capture, slack=1.0).offsets.any()


def test_a_budget_ends_the_fit(shrunk_capture):
    assert fit_reference(shrunk_capture, budget=1e-3).steps == 1
    assert fit_reference(shrunk_capture, budget=1e3).steps == ROUNDS


def test_too_little_time_is_no_sign_of_wrong_masks(shrunk_capture, monkeypatch):
    monkeypatch.setattr("ndf_mi.surface.reference.LEAST_AGREEMENT", 0.95)
    assert fit_reference(shrunk_capture, budget=1e-3).steps == ROUNDS


def with_mattes(capture: Capture, change) -> Capture:
    changed = copy.copy(capture)
    changed.matte = lambda name, frame: change(capture.matte(name, frame))
    return changed


@pytest.mark.parametrize(("change", "found"), [
    (lambda matte: 1 - matte, r"overlap by 0\.00 .*, and by 1\.00 where the masks are inverted"),
    (lambda matte: np.roll(matte, 22, axis=1), r"overlap by 0\.[01]\d \(intersection over union\)$"),
    (lambda matte: np.roll(matte, 12, axis=1), r"overlap by 0\.[4-6]\d .* after the surface was fitted"),
])
def test_masks_of_something_else_are_refused(capture, change, found):
    with pytest.raises(InputError, match="splits.train") as refused:
        fit_reference(with_mattes(capture, change))
    assert re.search(found, refused.value.found)
    assert "inverted" in refused.value.repair or "255" in refused.value.repair


def test_an_interrupt_passes(capture):
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_reference(capture, progress=interrupt)


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
