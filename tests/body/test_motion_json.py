"""Keyframes in JSON: interpolation against the closed form on quaternions, the root, and files that are
wrong.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ndf_mi.body import Body
from ndf_mi.body.motion_json import play_json
from ndf_mi.errors import InputError


def write(folder: Path, frames: Any, **more: Any) -> Path:
    path = folder / "wave.json"
    path.write_text(json.dumps({"frames": frames, **more}))
    return path


def quaternion_slerp(a: np.ndarray, b: np.ndarray, part: float) -> np.ndarray:
    """Shoemake (1985): sin((1-t)Ω)/sin Ω · q_a + sin(tΩ)/sin Ω · q_b on the nearer of ±q_b."""
    b = b if a @ b >= 0 else -b
    angle = np.arccos(a @ b)
    return (np.sin((1 - part) * angle) * a + np.sin(part * angle) * b) / np.sin(angle)


def test_slerp(small: Body, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    keys = rng.normal(size=(3, 3)) * 60
    frames = [{"time": t, "joints": {"arm": key.tolist()}} for t, key in zip((0, 0.5, 2), keys, strict=True)]
    motion, fps = play_json(small, write(tmp_path, frames), 10.0)
    assert fps == 10 and motion.pose.shape == (21, 4, 3) and not motion.pose[:, [0, 1, 3]].any()
    quaternions = Rotation.from_rotvec(keys, degrees=True).as_quat()
    for row, (a, part) in {0: (0, 0), 2: (0, 0.4), 5: (1, 0), 8: (1, 0.2), 19: (1, 14 / 15)}.items():
        want = quaternion_slerp(quaternions[a], quaternions[a + 1], part)
        have = Rotation.from_rotvec(motion.pose[row, 2].astype(np.float64)).as_quat()
        assert abs(have @ want) == pytest.approx(1, abs=1e-9)
        assert np.linalg.norm(motion.pose[row, 2]) <= np.pi + 1e-6


def test_each_joint_has_keyframes_of_its_own(small: Body, tmp_path: Path) -> None:
    frames = [{"time": 0, "joints": {"arm": [0, 0, 0]}}, {"time": 1, "joints": {"leg": [0, 40, 0]}},
              {"time": 2, "joints": {"arm": [0, 0, 80], "leg": [0, 80, 0]}}, {"time": 3}]  # fmt: skip
    motion, fps = play_json(small, write(tmp_path, frames, fps=2))
    assert fps == 2 and len(motion.pose) == 7
    np.testing.assert_allclose(np.degrees(motion.pose[:, 2, 2]), [0, 20, 40, 60, 80, 80, 80], atol=1e-4)
    np.testing.assert_allclose(np.degrees(motion.pose[:, 3, 1]), [40, 40, 40, 60, 80, 80, 80], atol=1e-4)


def test_the_root_turns_about_itself_and_moves(small: Body, tmp_path: Path) -> None:
    frames = [{"time": 0, "root": [0, 0, 0], "translation": [0, 0, 0]},
              {"time": 1, "root": [0, 90, 0], "translation": [1, 2, 3]}]
    motion, _ = play_json(small, write(tmp_path, frames), 1.0)
    root = small.joints[0].astype(np.float64)
    np.testing.assert_allclose(motion.translation[0], 0, atol=1e-6)
    turned = np.array([root[2], root[1], -root[0]])  # 90° about y: x → -z, z → x
    np.testing.assert_allclose(turned + motion.translation[1], root + [1, 2, 3], atol=1e-5)
    still, _ = play_json(small, write(tmp_path, [{"time": 0}]))
    assert len(still.pose) == 1 and not still.pose.any() and not still.translation.any()


def test_the_default_body_knows_smpls_names(anny: Body, tmp_path: Path) -> None:
    frames = [{"time": 0, "joints": {"left_elbow": [0, 0, 30], "Neck1": [10, 0, 0]}}]
    motion, _ = play_json(anny, write(tmp_path, frames))
    turned = {anny.joint_names[j] for j in np.flatnonzero(motion.pose[0].any(1))}
    assert turned == {"LeftForeArm", "Neck1"}


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([], r"frames: found \[\]; .*length >= 1"),
        ({}, r"frames: found \{\}; expected a list"),
        ([3], r"frames\[0\]: found 3; expected an object"),
        ([{}], r"frames\[0\].time: found nothing"),
        ([{"time": 0}, {"time": 0}], r"frames\[1\].time: found 0; .*ascending"),
        ([{"time": -1}], "found -1; expected a finite number >= 0"),
        ([{"time": 0, "joint": {}}], r"frames\[0\].joint: found an unknown key"),
        ([{"time": 0, "joints": {"elbow": [0, 0, 0]}}], "the joint 'elbow'; expected .*: chest, arm, leg"),
        ([{"time": 0, "joints": {"pelvis": [0, 0, 0]}}], "the joint 'pelvis'"),
        (
            [{"time": 0, "joints": {"arm": [0, 0]}}],
            r"joints.arm: found \[0, 0\]; expected a list of length 3",
        ),
        ([{"time": 0, "joints": {"arm": [0, "x", 0]}}], 'joints.arm.1.: found "x"; expected a finite number'),
        (
            [{"time": 0, "joints": {"arm": [0, 10**400, 0]}}],
            "joints.arm.1.: found 1000.*; expected a finite number",
        ),
        ([{"time": 10**400}], r"frames\[0\].time: found 1000.*; expected a finite number"),
        ([{"time": 0, "root": [0, float("nan"), 0]}], "root.1.: found NaN; expected a finite number"),
    ],
)
def test_refuses(small: Body, tmp_path: Path, frames: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        play_json(small, write(tmp_path, frames))


def test_refuses_what_is_no_motion(small: Body, anny: Body, tmp_path: Path) -> None:
    path = tmp_path / "wave.json"
    deep = '{"frames": ' + "[" * 100_000
    stills = '{"frames": [{"time": 0}], "fps": 0}'
    for text, message in (("{", "cannot be read as JSON"), (deep, "as JSON .nested too deep."),
                          ("[]", "an object"), (stills, "fps: found 0")):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            play_json(small, path)
    both = {"LeftForeArm": [0, 0, 1], "left_elbow": [0, 0, 2]}
    with pytest.raises(InputError, match="two names"):
        play_json(anny, write(tmp_path, [{"time": 0, "joints": both}]))
    with pytest.raises(InputError, match="no skinning model"):
        play_json(Body(small.faces, small.uv, small.uv_faces), write(tmp_path, [{"time": 0}]))
