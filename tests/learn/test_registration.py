"""Known errors of poses and cameras are undone by the outlines of masks; what cannot be refined is refused.
"""

import dataclasses

import numpy as np
import pytest

from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.capture.silhouette import Silhouettes
from ndf_mi.errors import InputError
from ndf_mi.learn.camera_corrections import corrected
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.registration import PREFIX, Registration, register

OPTIONS = TrainingOptions(refine_outlines=8, refine_frames=0.0)
NAMES = ("c0", "c1", "c2", "c3")


@pytest.fixture(scope="module")
def truth(capture):
    """An arm of two joints, bent by different angles in the two training frames, and its exact masks."""
    template = capture.body.template * np.array([2.0, 0.25, 0.4])
    bend = np.clip(0.5 + 5 * template[:, 0], 0, 1)
    body = dataclasses.replace(
        capture.body, template=template, joints=np.array([[-0.3, 0, 0], [0.0, 0, 0]]),
        joint_names=("shoulder", "elbow"), parents=np.array([-1, 0]), weights=np.stack([1 - bend, bend], 1),
        shape_dirs=(template * [0, 1, 1])[..., None], joint_dirs=np.zeros((2, 3, 1)),
        shape_names=("thickness",))
    pose = np.zeros((3, 2, 3))
    pose[:, 1] = [[0, 0.5, 0.2], [0, -0.3, 0.6], [0, 0, 0]]
    poses = posed(body, capture.poses.frames, pose, np.full((3, 3), 0.2), np.zeros((3, 3)), np.zeros(1))
    changed = capture.with_body(body, poses).with_cameras(
        [capture.cameras[name].scaled(128, 128) for name in NAMES])
    caster, mattes = Silhouettes(body.faces, len(template)), {}
    for frame in changed.splits["train"].frames:
        caster.pose(poses.vertices[poses.index(frame)])
        for name in NAMES:
            mattes[name, frame] = caster.draw(changed.cameras[name]).astype(np.float32)
    changed.matte = lambda name, frame: mattes[name, frame]
    return changed


def posed(body, frames, pose, root, translation, shape):
    vertices = [np.asarray(skin(body, *row, shape)).reshape(-1, 3)
                for row in zip(pose, root, translation, strict=True)]
    return Poses(frames, np.stack(vertices), pose, root, translation, shape)


def perturbed(truth, bend=0.0, root=0.0, shift=0.0, shape=0.0):
    """The capture with errors of opposite sign in its two training frames, and of the shape."""
    poses, signs = truth.poses, np.array([1, -1, 0])[:, None]
    pose = poses.pose.copy()
    pose[:, 1] += signs * [0, bend, -bend]
    wrong = posed(truth.body, poses.frames, pose, poses.root_rotation + signs * [0, root, root],
                  poses.translation + signs * [shift, shift, 0], poses.shape + shape)
    return truth.with_body(truth.body, wrong)


def vertex_error(found, truth):
    return np.linalg.norm(found.poses.vertices[:2] - truth.poses.vertices[:2], axis=2).mean()


def test_poses_are_found(truth):
    wrong = perturbed(truth, bend=0.15, root=0.1, shift=0.02)
    found = register(wrong, dataclasses.replace(OPTIONS, refine=("pose",)))
    assert vertex_error(wrong, truth) > 0.03
    assert vertex_error(found.capture, truth) < 0.2 * vertex_error(wrong, truth)
    np.testing.assert_array_equal(found.capture.poses.vertices[2], wrong.poses.vertices[2])
    poses = found.capture.poses
    again = posed(truth.body, poses.frames, poses.pose, poses.root_rotation, poses.translation, poses.shape)
    np.testing.assert_allclose(again.vertices, poses.vertices, atol=1e-5)
    assert found.tensors[f"{PREFIX}pose"].shape == (2, 2, 3)


def test_the_prior_interpolates_frames_that_are_not_measured(truth):
    wrong = perturbed(truth, shift=0.02)
    found = Registration(wrong, ("pose",), correlation=10.0, seed=0)
    found.step(noise=0.02, robust=0.1, cameras=False, every=2)
    moved = found.tensors()[f"{PREFIX}translation"]
    frames = truth.splits["train"].frames
    kept = np.exp(-(frames[1] - frames[0]) / 10)
    np.testing.assert_allclose(moved[1], kept * moved[0], atol=1e-5)
    assert np.abs(moved[0]).max() > 0.01


def test_a_camera_is_found(truth):
    camera = corrected(truth.cameras["c1"], np.radians([0.5, 0.5, 0.0]), np.zeros(3), 0.0)
    found = register(truth.with_cameras([camera]), dataclasses.replace(OPTIONS, refine=("cameras",)))

    def error(cameras):
        centre = np.zeros((1, 3))
        return np.linalg.norm(cameras["c1"].project(centre) - truth.cameras["c1"].project(centre))

    assert error({"c1": camera}) > 1
    assert error(found.capture.cameras) < 0.3 * error({"c1": camera})
    assert found.capture.poses is truth.poses and f"{PREFIX}pose" not in found.tensors


def test_a_right_fit_stays(truth):
    options = dataclasses.replace(OPTIONS, refine=("pose", "shape", "cameras"))
    found = register(truth, options)
    assert vertex_error(found.capture, truth) < 8e-3  # a pixel is 11 mm wide
    for name in NAMES:
        assert np.abs(found.capture.cameras[name].transform - truth.cameras[name].transform).max() < 8e-3


def test_registration_repeats(truth):
    wrong = perturbed(truth, bend=0.1)
    options = dataclasses.replace(OPTIONS, refine=("pose",), refine_outlines=2)
    one, other = (register(wrong, options).capture.poses for _ in range(2))
    np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-6)


def test_a_budget_ends_it(truth):
    taken: list[int] = []
    register(truth, dataclasses.replace(OPTIONS, refine=("pose",)), budget=1e-6, progress=taken.append)
    assert taken == [1]


def test_nothing_to_refine(capture):
    assert register(capture, OPTIONS).capture is capture
    options = dataclasses.replace(OPTIONS, refine=("cameras",), refine_outlines=0)
    assert register(capture, options).tensors == {}


@pytest.mark.parametrize("name", ["pose", "shape"])
def test_a_body_without_skinning_is_refused(capture, name):
    with pytest.raises(InputError, match="without skinning"):
        register(capture, dataclasses.replace(OPTIONS, refine=(name,)))


def test_a_body_without_shapes_is_refused(truth):
    body = dataclasses.replace(truth.body, shape_dirs=None, joint_dirs=None, shape_names=None)
    poses = dataclasses.replace(truth.poses, shape=None)
    with pytest.raises(InputError, match="shape_dirs"):
        register(truth.with_body(body, poses), dataclasses.replace(OPTIONS, refine=("shape",)))
