"""Corrections of the body: nothing without them, gradients as in closed form, and poses that agree with
skinning once they are baked."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.learn.corrections import Corrections
from ndf_mi.learn.pose_corrections import PoseCorrections, mixing

FRAMES, TRAINING = np.array([3, 4, 8, 9]), (3, 4, 8)


@pytest.fixture(scope="module")
def body():
    """A body of 30 vertices and 3 joints, all random; its triangles mean nothing."""
    rng = np.random.default_rng(7)
    weights = rng.random((30, 3)) + 1e-3
    return Body(faces=rng.integers(0, 30, (20, 3)), uv=rng.random((30, 2)),
                uv_faces=rng.integers(0, 30, (20, 3)), template=rng.normal(size=(30, 3)),
                joints=rng.normal(size=(3, 3)), joint_names=("pelvis", "chest", "arm"),
                parents=np.array([-1, 0, 1]), weights=weights / weights.sum(1, keepdims=True),
                shape_dirs=rng.normal(size=(30, 3, 2)) * 0.1, joint_dirs=rng.normal(size=(3, 3, 2)) * 0.1,
                shape_names=("height", "weight"))


@pytest.fixture(scope="module")
def poses(body):
    """Random poses whose vertices differ from the skinned ones by constants."""
    rng = np.random.default_rng(8)
    pose, root, shift = (rng.normal(size=shape) * 0.5 for shape in ((4, 3, 3), (4, 3), (4, 3)))
    pose[:, 0] = 0
    shape = rng.normal(size=2)
    vertices = np.stack([skinned(body, *row, shape) for row in zip(pose, root, shift, strict=True)])
    return Poses(FRAMES, vertices + 0.02 * rng.normal(size=vertices.shape), pose, root, shift, shape)


@pytest.fixture(scope="module")
def corrections(body, poses):
    return PoseCorrections(body, poses, TRAINING, correlation=2.0)


def skinned(body, *arguments):
    return np.asarray(skin(body, *arguments)).reshape(-1, 3)


def random_values(corrections, seed=0):
    rng = np.random.default_rng(seed)
    return Corrections(pose=mi.Float(rng.normal(size=corrections.pose_count).astype(np.float32)),
                       shape=mi.Float(rng.normal(size=corrections.shape_count).astype(np.float32)))


def test_zero_corrections_give_exactly_the_poses(corrections, poses):
    zero = Corrections(pose=dr.opaque(mi.Float, 0.0, corrections.pose_count),
                       shape=dr.opaque(mi.Float, 0.0, corrections.shape_count))
    for row, frame in enumerate(FRAMES):
        found = np.asarray(corrections.vertices(zero, int(frame))).reshape(-1, 3)
        np.testing.assert_array_equal(found, poses.vertices[row])
        assert (corrections.angles(zero, int(frame)) == 0).all()
    baked = corrections.baked(zero)
    np.testing.assert_array_equal(baked.vertices, poses.vertices)
    np.testing.assert_array_equal(baked.pose, poses.pose)


def test_baked_poses_agree_with_skinning(body, poses, corrections):
    values = random_values(corrections)
    baked = corrections.baked(values)
    for row, frame in enumerate(FRAMES):
        def of(poses, row=row):
            return skinned(body, poses.pose[row], poses.root_rotation[row], poses.translation[row],
                           poses.shape)

        carried = poses.vertices[row] - of(poses)
        np.testing.assert_allclose(baked.vertices[row], of(baked) + carried, atol=3e-6)
        moved = np.abs(baked.pose[row] - poses.pose[row]).max() > 0.01
        assert moved == (frame in TRAINING)
    # Other frames have the shape's correction only.
    assert np.abs(baked.vertices[3] - poses.vertices[3]).max() > 1e-3
    only_pose = corrections.baked(Corrections(pose=values.pose))
    np.testing.assert_array_equal(only_pose.vertices[3], poses.vertices[3])
    np.testing.assert_array_equal(only_pose.shape, poses.shape)


def test_a_turn_leaves_the_root_joint_in_place(body, poses, corrections):
    values = np.zeros((3, corrections.pose_count // 3), np.float32)
    values[:, :3] = 3.0
    baked = corrections.baked(Corrections(pose=mi.Float(values.ravel())))
    joint = body.joints[0] + body.joint_dirs[0] @ poses.shape
    for row in range(3):
        before, after = (Rotation.from_rotvec(each.root_rotation[row]).apply(joint) + each.translation[row]
                         for each in (poses, baked))
        np.testing.assert_allclose(after, before, atol=1e-5)
        assert np.abs(baked.vertices[row] - poses.vertices[row]).max() > 0.1


def closed_form(body, poses, row, weights, y, z):
    """Vertices of a training frame in float64: y (T, K) and z (B,) as trained."""
    values = weights @ y * np.array([np.radians(5.0)] * 9 + [0.02] * 3)
    spread = np.sqrt(np.square(body.shape_dirs.astype(np.float64)).sum(1).mean(0))
    beta = poses.shape.astype(np.float64) + 0.01 * z / spread
    rest = body.template.astype(np.float64) + body.shape_dirs.astype(np.float64) @ beta
    joints = body.joints.astype(np.float64) + body.joint_dirs.astype(np.float64) @ beta
    added = np.concatenate([np.zeros((1, 3)), values[3:9].reshape(2, 3)])
    turns = Rotation.from_rotvec(poses.pose[row] + added)
    blended, turn, place = 0.0, Rotation.identity(), np.zeros(3)
    for j in range(3):
        offset = joints[j] - (joints[j - 1] if j else 0)
        place = place + turn.apply(offset)
        turn = turn * turns[j]
        blended = blended + body.weights[:, j : j + 1] * (turn.apply(rest - joints[j]) + place)
    root = Rotation.from_rotvec(poses.root_rotation[row])
    pivot = (root.apply(body.joints[0] + body.joint_dirs[0].astype(np.float64) @ poses.shape)
             + poses.translation[row])
    posed = root.apply(blended) + poses.translation[row]
    return Rotation.from_rotvec(values[:3]).apply(posed - pivot) + pivot + values[9:]


def test_gradients_are_those_of_differences(body, poses, corrections):
    start = random_values(corrections, 1)
    dr.enable_grad(start.pose, start.shape)
    rng = np.random.default_rng(2)
    seeds = rng.normal(size=(30, 3))
    frame = TRAINING[1]
    dr.backward(dr.sum(corrections.vertices(start, frame) * mi.Float(seeds.astype(np.float32).ravel())))
    y = np.asarray(dr.detach(start.pose), np.float64).reshape(3, -1)
    z = np.asarray(dr.detach(start.shape), np.float64)
    weights, step = mixing(np.array(TRAINING), 2.0)[1], 1e-5

    def functional(y, z):
        return (seeds * closed_form(body, poses, 1, weights, y, z)).sum()

    for _ in range(4):
        dy, dz = rng.normal(size=y.shape), rng.normal(size=z.shape)
        high, low = (functional(y + s * dy, z + s * dz) for s in (step, -step))
        expected = (high - low) / (2 * step)
        found = ((np.asarray(dr.grad(start.pose)).reshape(y.shape) * dy).sum()
                 + (np.asarray(dr.grad(start.shape)) * dz).sum())
        assert found == pytest.approx(expected, rel=2e-3, abs=2e-3)


def test_frames_are_correlated_by_their_distance():
    frames, mixed = np.array(TRAINING), mixing(np.array(TRAINING), 2.0)
    np.testing.assert_allclose(mixed @ mixed, np.exp(-np.abs(frames[:, None] - frames) / 2.0), atol=1e-12)
    np.testing.assert_array_equal(mixing(frames, 0.0), np.eye(3))
