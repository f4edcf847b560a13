"""AMASS-like files: on a body with SMPL's joints against forward kinematics in numpy, on the default body
against what a pose means.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ndf_mi.body import Body
from ndf_mi.body.motion import Motion
from ndf_mi.body.motion_amass import play_amass
from ndf_mi.body.skinning import joint_transforms
from ndf_mi.errors import InputError

NAMES = ("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle",
         "right_ankle", "spine3",
         "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
         "right_shoulder",
         "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand")  # fmt: skip
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
LIMBS = (("UpLeg", "Leg"), ("Leg", "Foot"), ("Foot", "ToeBase"), ("Arm", "ForeArm"), ("ForeArm", "Hand"))


@pytest.fixture
def smpl() -> Body:
    """SMPL's joints in random places, a mesh that means nothing, and one shape coefficient that scales the
    skeleton by 1 + β.
    """
    rng = np.random.default_rng(3)
    joints = rng.normal(size=(24, 3))
    return Body(
        faces=np.array([[0, 1, 2]]), uv=rng.random((3, 2)), uv_faces=np.array([[0, 1, 2]]),
        template=rng.normal(size=(24, 3)),
        joints=joints, joint_names=NAMES,
        parents=np.array(PARENTS), weights=np.eye(24), shape_dirs=np.zeros((24, 3, 1)),
        joint_dirs=joints[..., None],
    )  # fmt: skip


def write(path: Path, **changes: object) -> Path:
    """3 s of 156 numbers at 60 Hz, smooth and large, as AMASS has them; entries of None are left out."""
    t = np.arange(181) / 60
    rng = np.random.default_rng(5)
    poses = np.sin(t[:, None] + rng.normal(size=156)) * rng.normal(size=156)
    entries = {"poses": poses, "trans": np.stack([t, t * t, np.sin(t)], 1), "mocap_framerate": np.array(60.0),
               "gender": np.array("male")}
    np.savez(path, **{k: v for k, v in (entries | changes).items() if v is not None})
    return path


def kinematics(poses: np.ndarray, trans: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(24, 3): SMPL's posed joints by its own convention, the root turned about itself, in y up from z up."""
    at = np.zeros((24, 3))
    turns = np.zeros((24, 3, 3))
    for j, p in enumerate(PARENTS):
        local = np.eye(3) if j > 21 else Rotation.from_rotvec(poses[3 * j : 3 * j + 3]).as_matrix()
        turns[j] = local if p < 0 else turns[p] @ local
        at[j] = joints[0] + trans if p < 0 else at[p] + turns[p] @ (joints[j] - joints[p])
    return np.stack([at[:, 0], at[:, 2], -at[:, 1]], 1)


def posed_joints(body: Body, motion: Motion, row: int, shape: np.ndarray | None = None) -> np.ndarray:
    transforms = joint_transforms(body, motion.pose[row], motion.root_rotation[row], motion.translation[row],
                                  shape)
    matrices = np.array(transforms.matrices, dtype=np.float64).reshape(-1, 3, 4)
    joints = body.joints if shape is None else body.joints + body.joint_dirs @ shape
    return np.einsum("jab,jb->ja", matrices[:, :, :3], joints) + matrices[:, :, 3]


@pytest.mark.parametrize("named", [True, False])
def test_joints_are_where_kinematics_puts_them(smpl: Body, tmp_path: Path, named: bool) -> None:
    body = smpl if named else dataclasses.replace(smpl, joint_names=tuple(map(str, range(24))))
    path = write(tmp_path / "a.npz")
    found = np.load(path)
    motion = play_amass(body, path, 20.0)
    assert motion.pose.shape == (61, 24, 3) and not motion.pose[:, [0, 22, 23]].any()
    for row in (0, 17, 60):
        want = kinematics(found["poses"][3 * row], found["trans"][3 * row], smpl.joints.astype(np.float64))
        np.testing.assert_allclose(posed_joints(smpl, motion, row), want, atol=2e-5)


def test_rotations_between_frames_take_the_shorter_way(smpl: Body, tmp_path: Path) -> None:
    poses = np.zeros((2, 66))
    poses[1, 12:15] = np.radians([0, 80, 0])
    path = write(tmp_path / "a.npz", poses=poses, trans=np.array([[0, 0, 0], [0, 0, 1]]),
                 mocap_framerate=np.array(1))
    motion = play_amass(smpl, path, 4.0, up="y")
    np.testing.assert_allclose(np.degrees(motion.pose[:, 4]), np.outer(np.arange(5) * 20, [0, 1, 0]),
                               atol=1e-4)
    np.testing.assert_allclose(motion.translation, np.outer(np.arange(5) / 4, [0, 0, 1]), atol=1e-6)


@pytest.mark.parametrize("betas", [[0.25, 3.0], [[0.25, 3.0]]])
def test_the_path_follows_the_legs(smpl: Body, tmp_path: Path, betas: list) -> None:
    """The file's performer is 1.25 times the template, the body 0.5 times: the root goes 0.4 times as far,
    from 0.4 times as high.
    """
    path = write(tmp_path / "a.npz", betas=np.array(betas))
    found = np.load(path)
    shape = np.array([-0.5])
    motion = play_amass(smpl, path, 60.0, shape=shape)
    for row in (0, 100):
        x, y, z = 0.4 * (1.25 * smpl.joints[0] + found["trans"][row])
        np.testing.assert_allclose(posed_joints(smpl, motion, row, shape)[0], [x, z, -y], atol=1e-5)


def test_betas_that_are_not_used_are_not_read(anny: Body, smpl: Body, tmp_path: Path) -> None:
    path = write(tmp_path / "a.npz", betas=np.array([None], dtype=object))
    assert len(play_amass(anny, path, 3.0).pose)
    with pytest.raises(InputError, match="betas"):
        play_amass(smpl, path, 3.0)


def anny_bones(
    anny: Body, tmp_path: Path, joint: str = "spine1", turn: tuple[float, float, float] = (0, 0, 0)
) -> dict[str, np.ndarray]:
    """Unit vectors along the default body's limbs, both sides, at one pose of SMPL's: one joint turned,
    degrees, y up.
    """
    poses = np.zeros((1, 72))
    poses[0, 3 * NAMES.index(joint) :][:3] = np.radians(turn)
    motion = play_amass(anny, write(tmp_path / "a.npz", poses=poses, trans=np.zeros((1, 3))), 30.0, up="y")
    at = dict(zip(anny.joint_names, posed_joints(anny, motion, 0), strict=True))
    bones = {side + a: at[side + b] - at[side + a] for side in ("Left", "Right") for a, b in LIMBS}
    return {name: bone / np.linalg.norm(bone) for name, bone in bones.items()}


def test_no_rotation_is_a_t_pose_of_the_default_body(anny: Body, tmp_path: Path) -> None:
    bones = anny_bones(anny, tmp_path)
    for side, sign in (("Left", 1), ("Right", -1)):
        for name in ("Arm", "ForeArm"):
            assert bones[side + name] @ [sign, 0, 0] > 0.99
        for name in ("UpLeg", "Leg"):
            assert bones[side + name] @ [0, -1, 0] > 0.98
        rest = (
            anny.joints[anny.joint_names.index(f"{side}ToeBase")]
            - anny.joints[anny.joint_names.index(f"{side}Foot")]
        )
        np.testing.assert_allclose(bones[f"{side}Foot"], rest / np.linalg.norm(rest), atol=1e-5)


@pytest.mark.parametrize(
    ("joint", "turn", "bone", "towards"),
    [
        ("left_elbow", (0, -90, 0), "LeftForeArm", (0, 0, 1)),
        ("right_shoulder", (0, 0, 90), "RightArm", (0, -1, 0)),
        ("left_hip", (-90, 0, 0), "LeftUpLeg", (0, 0, 1)),
        ("right_knee", (90, 0, 0), "RightLeg", (0, 0, -1)),
        ("spine3", (0, 90, 0), "LeftArm", (0, 0, -1)),
        ("pelvis", (0, -90, 0), "LeftArm", (0, 0, 1)),
    ],
)
def test_single_joints_of_the_default_body(
    anny: Body, tmp_path: Path, joint: str, turn: tuple[float, float, float], bone: str,
    towards: tuple[float, float, float]
) -> None:
    still, bones = anny_bones(anny, tmp_path), anny_bones(anny, tmp_path, joint, turn)
    assert bones[bone] @ towards > 0.98
    if joint != "pelvis":
        np.testing.assert_allclose(bones["RightUpLeg"], still["RightUpLeg"], atol=1e-6)


def test_z_up_stands_on_the_ground(anny: Body, tmp_path: Path) -> None:
    """The performer of the file stands along z and walks along its -y, its own ahead; here that is z."""
    poses = np.zeros((31, 156))
    poses[:, 0] = np.pi / 2
    walk = np.outer(np.arange(31) / 30, [0, -1, 0]) + [0, 0, 1]
    motion = play_amass(anny,
                        write(tmp_path / "a.npz", poses=poses, trans=walk, mocap_framerate=np.array(30)),
                        10.0)
    assert len(motion.pose) == 11
    first, last = (dict(zip(anny.joint_names, posed_joints(anny, motion, row), strict=True))
                   for row in (0, 10))
    assert 1.4 < first["Head"][1] < 1.7 and abs(first["LeftToeBase"][1] - 0.025) < 0.02
    step = last["Hips"] - first["Hips"]
    assert step[2] > 0.8 and np.abs(step[:2]).max() < 1e-5


def test_a_body_with_other_joints_is_told_their_names(small: Body, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="clip a: found no pelvis, chest, arm, leg"):
        play_amass(small, write(tmp_path / "a.npz"), 30.0)


def with_nan() -> np.ndarray:
    poses = np.zeros((181, 72))
    poses[7, 3 * 4 + 1] = np.nan
    return poses


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": np.zeros((181, 100))},
         r"poses: found .* \(181, 100\); expected numbers of shape \(T, one of 66, 72, 156, 165\)"),
        ({"poses": np.zeros((0, 72)), "trans": np.zeros((0, 3))}, "poses: found no frame"),
        ({"poses": with_nan()}, "poses: found nan at frame 7, joint left_knee"),
        ({"trans": np.zeros((180, 3))}, r"trans: .*\(180, 3\); expected numbers of shape \(181, 3\)"),
        ({"trans": np.full((181, 3), np.inf)}, "trans: found inf at frame 0, joint pelvis"),
        ({"trans": None}, "trans"),
        ({"mocap_framerate": None}, "mocap_framerate or mocap_frame_rate"),
        ({"mocap_framerate": np.array(0)}, "above 0"),
        ({"betas": np.array([np.nan])}, "betas"),
    ],
)
def test_refuses(smpl: Body, tmp_path: Path, changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        play_amass(smpl, write(tmp_path / "a.npz", **changes), 30.0)
