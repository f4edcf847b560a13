"""Retargeting: bones point where the clip's point, feet reach the ground, and mismatches are named."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from ndf_mi.body import Body
from ndf_mi.body.bvh import Clip, read_bvh
from ndf_mi.body.motion import load_clip, pose_sequence, retarget, shipped_clips
from ndf_mi.body.skinning import joint_transforms, skin
from ndf_mi.errors import InputError


def posed_joints(body: Body, motion, row: int) -> dict[str, np.ndarray]:
    """Joint positions through the Dr.Jit skinning, which the retargeting itself does not use."""
    transforms = joint_transforms(body, motion.pose[row], motion.root_rotation[row], motion.translation[row])
    matrices = np.array(transforms.matrices, dtype=np.float64).reshape(-1, 3, 4)
    at = np.einsum("jab,jb->ja", matrices[:, :, :3], body.joints) + matrices[:, :, 3]
    return dict(zip(body.joint_names, at, strict=True))


def direction(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (b - a) / np.linalg.norm(b - a)


def test_shipped() -> None:
    assert {"jump", "walk", "climb"} <= set(shipped_clips())
    for name in shipped_clips():
        clip = load_clip(name)
        assert 3 < clip.duration < 5 and clip.frame_time == pytest.approx(1 / 30, rel=1e-3)
        assert len(clip.joint_names) == 31
    with pytest.raises(InputError, match="expected a BVH file or one of the clips climb, jump, walk"):
        load_clip("swim")


@pytest.mark.parametrize("name", ["jump", "walk"])
def test_limbs_point_as_in_the_clip(anny: Body, name: str) -> None:
    clip = load_clip(name)
    rows = [5, 40, 70]
    motion = retarget(anny, clip)
    _, source = clip.forward()
    for row in rows:
        have = posed_joints(anny, motion, row)
        want = dict(zip(clip.joint_names, source[row], strict=True))
        for side in ("Left", "Right"):
            for a, b in (("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand")):
                bone = direction(have[side + a], have[side + b]) @ direction(want[side + a], want[side + b])
                assert bone > 0.99999, (row, side, a)


def test_path_is_scaled_by_the_legs(anny: Body) -> None:
    """Steps are as many leg lengths long as in the clip."""
    clip = load_clip("jump")
    motion = retarget(anny, clip)
    _, source = clip.forward()
    ends = []
    for joints in ([posed_joints(anny, motion, row) for row in (0, len(clip) - 1)],
                   [dict(zip(clip.joint_names, source[row], strict=True)) for row in (0, len(clip) - 1)]):
        first, last = joints
        knee = first["LeftLeg"]
        leg = np.linalg.norm(first["LeftUpLeg"] - knee) + np.linalg.norm(knee - first["LeftFoot"])
        middle = [(j["LeftUpLeg"] + j["RightUpLeg"]) / 2 for j in joints]
        ends.append((middle[1] - middle[0]) / leg)
    np.testing.assert_allclose(ends[0], ends[1], atol=0.05)
    assert np.linalg.norm(ends[0]) > 1


@pytest.mark.parametrize("shape", [None, [1, 0.5, 0, 1, 0, 0], [-1, 0, 0, -1, 0, 0.5]])
def test_stands_on_the_ground(anny: Body, shape: list[float] | None) -> None:
    poses = pose_sequence(anny, load_clip("walk"), range(0, 90, 5), shape=shape)
    low = poses.vertices[:, :, 1].min(1)
    assert abs(low.min()) < 0.02 and np.median(low) < 0.03
    assert (np.ptp(poses.vertices[:, :, 1], axis=1) > 1.2).all()


def test_jump_leaves_the_ground(anny: Body) -> None:
    low = pose_sequence(anny, load_clip("jump"), range(0, 120, 4)).vertices[:, :, 1].min(1)
    assert low.min() < 0.02 < 0.1 < low.max()


def test_arms_stay_out_of_the_trunk(anny: Body) -> None:
    """The hands lie outside the convex hull of the trunk."""
    poses = pose_sequence(anny, load_clip("jump"), [0, 40, 80])
    names = anny.joint_names
    owner = anny.weights.argmax(1)
    arms = [j for j, n in enumerate(names) if n.endswith(("Hand", "HandFinger1"))]
    trunk = np.isin(owner, [names.index(n) for n in ("Hips", "LowerBack", "Spine", "Spine1")])
    hands = np.isin(owner, arms)
    for row in range(3):
        vertices = poses.vertices[row]
        planes = ConvexHull(vertices[trunk]).equations
        inside = (vertices[hands] @ planes[:, :3].T + planes[:, 3] < 0).all(1)
        assert inside.mean() < 0.05


def test_places(anny: Body) -> None:
    clip = load_clip("jump")
    world, centre, treadmill = (retarget(anny, clip, place=p) for p in ("world", "centre", "treadmill"))
    np.testing.assert_allclose(np.ptp(centre.translation, axis=0), np.ptp(world.translation, axis=0),
                               atol=1e-5)
    np.testing.assert_allclose(centre.translation[:, 1], world.translation[:, 1])
    for row in (0, 60, 119):
        joints = posed_joints(anny, treadmill, row)
        np.testing.assert_allclose((joints["LeftUpLeg"] + joints["RightUpLeg"])[[0, 2]], 0, atol=1e-5)
    hips = np.array([posed_joints(anny, centre, row)["LeftUpLeg"] for row in range(0, 120, 20)])
    assert np.abs(hips[:, [0, 2]]).max() < 1.2


def test_sequence(anny: Body) -> None:
    clip = load_clip("climb")
    poses = pose_sequence(anny, clip, [5, 10], rate=30)
    assert poses.frames.tolist() == [5, 10] and (poses.pose[:, 0] == 0).all()
    same = retarget(anny, clip)
    np.testing.assert_allclose(poses.pose, same.pose[[5, 10]], atol=1e-3)
    every = pose_sequence(anny, clip, rate=5)
    assert every.frames.tolist() == list(range(17))  # 101 frames at 30 Hz
    every.check(anny)
    with pytest.raises(InputError, match="clip climb: found times from"):
        pose_sequence(anny, clip, [500])
    with pytest.raises(InputError, match=r"shape: found shape \(2,\); expected \(6,\)"):
        pose_sequence(anny, clip, [0], shape=[1, 2])


def test_a_rig_of_its_own(small: Body) -> None:
    """A clip of the body's own skeleton in centimetres, whose joints are nobody's: it is played unchanged, on
    the ground.
    """
    rng = np.random.default_rng(1)
    body = dataclasses.replace(small, weights=np.eye(4)[np.arange(40) % 4], pose_dirs=None, joint_dirs=None)
    joints = body.joints.astype(np.float64)
    offsets = 100 * np.array([joints[j] - (joints[p] if p >= 0 else 0) for j, p in enumerate(body.parents)])
    positions = np.tile(offsets, (6, 1, 1))
    positions[:, 0] = [[50 * row, 90 + 10 * row, -30 * row] for row in range(6)]
    rotations = Rotation.random(24, random_state=rng).as_matrix().reshape(6, 4, 3, 3)
    clip = Clip("own", body.joint_names, body.parents, offsets, 0.1, positions, rotations)
    motion = retarget(body, clip)
    _, source = clip.forward()
    have = np.array([[*posed_joints(body, motion, row).values()] for row in range(6)])
    shift = have - source / 100
    np.testing.assert_allclose(shift, np.broadcast_to([0, shift[0, 0, 1], 0], shift.shape), atol=1e-5)
    rows = zip(motion.pose, motion.root_rotation, motion.translation, strict=True)
    assert min(np.array(skin(body, *row)).reshape(-1, 3)[:, 1].min() for row in rows) == pytest.approx(
        0, abs=1e-5
    )
    centre = retarget(body, clip, place="centre").translation
    treadmill = retarget(body, clip, place="treadmill")
    assert np.abs([posed_joints(body, treadmill, row)["pelvis"][[0, 2]] for row in range(6)]).max() < 1e-5
    np.testing.assert_allclose(np.ptp(centre, axis=0), np.ptp(motion.translation, axis=0), atol=1e-5)
    flat = dataclasses.replace(clip, positions=0 * positions, offsets=0 * offsets)
    with pytest.raises(InputError, match="clip own: found bones of no length"):
        retarget(body, flat)


def test_mismatch_names_the_joints(anny: Body, small: Body, tmp_path: Path) -> None:
    clip = load_clip("walk")
    renamed = tuple({"LeftArm": "l_arm", "Head": "skull"}.get(n, n) for n in clip.joint_names)
    with pytest.raises(InputError, match=r"clip walk: found no LeftArm, Head \(but .*l_arm.*\)"):
        retarget(anny, dataclasses.replace(clip, joint_names=renamed))
    with pytest.raises(InputError, match="no pelvis, chest, arm, leg"):
        retarget(small, clip)
    with pytest.raises(InputError, match="no skinning model"):
        retarget(Body(small.faces, small.uv, small.uv_faces), clip)
    own = tmp_path / "own.bvh"
    own.write_text("HIERARCHY\n")
    with pytest.raises(InputError, match="own.bvh, line 1"):
        read_bvh(own)
