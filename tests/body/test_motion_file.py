"""Any motion on a body: which reader a file goes to, a capture's poses, and where the body is put."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from ndf_mi.body import Body, Poses, bvh
from ndf_mi.body.motion import load_clip, retarget
from ndf_mi.body.motion_file import read_performance
from ndf_mi.body.motion_smpl import COUNTERPARTS, LAYOUTS
from ndf_mi.body.skinning import skin
from ndf_mi.errors import InputError


@pytest.fixture
def poses(small: Body) -> Poses:
    """Five poses of `small` whose vertices are off from the skinned ones by a centimetre, as a fit's may
    be.
    """
    rng = np.random.default_rng(4)
    pose, root, translation = rng.normal(size=(5, 4, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3)) * 3
    pose[:, 0] = 0
    shape = np.array([0.5, -1], np.float32)
    rows = zip(pose, root, translation, strict=True)
    vertices = np.stack([skin(small, *row, shape).numpy().reshape(-1, 3) + 0.01 for row in rows])
    return Poses(np.array([3, 4, 6, 7, 9]), vertices, pose, root, translation, shape)


def test_poses_are_played_as_they_are(small: Body, poses: Poses, tmp_path: Path) -> None:
    poses.write(tmp_path / "poses.npz")
    small.write(tmp_path / "body.npz")
    performance = read_performance(tmp_path / "poses.npz", small, poses)
    assert len(performance) == 5 and performance.fps == 30
    assert all(np.array_equal(performance.vertices(row), poses.vertices[row]) for row in range(5))
    assert np.array_equal(performance.motion.pose, poses.pose)


def test_another_performers_poses_are_skinned(small: Body, poses: Poses, tmp_path: Path) -> None:
    """With the run's shape, whatever the file's; and so they are with a shape that was asked for."""
    dataclasses.replace(poses, shape=np.array([2, 0], np.float32)).write(tmp_path / "poses.npz")
    for shape in (None, np.array([0.25, 0.5], np.float32)):
        performance = read_performance(tmp_path / "poses.npz", small, poses, shape=shape)
        used = poses.shape if shape is None else shape
        want = (
            skin(small, poses.pose[2], poses.root_rotation[2], poses.translation[2], used)
            .numpy()
            .reshape(-1, 3)
        )
        np.testing.assert_allclose(performance.vertices(2), want, atol=1e-6)


def test_a_shape_moves_vertices_by_its_directions(small: Body, poses: Poses, tmp_path: Path) -> None:
    """At rest, of joints that stay: template + dirs · β."""
    (tmp_path / "rest.json").write_text('{"frames": [{"time": 0}]}')
    body = dataclasses.replace(small, joint_dirs=None)
    rest, changed = (
        read_performance(tmp_path / "rest.json", body, poses, shape=np.array(shape, np.float32)).vertices(0)
        for shape in ([0, 0], [0.5, -2])
    )
    np.testing.assert_allclose(rest, small.template, atol=1e-5)
    np.testing.assert_allclose(changed - rest, 0.5 * small.shape_dirs[..., 0] - 2 * small.shape_dirs[..., 1],
                               atol=1e-5)


def test_places(small: Body, poses: Poses, tmp_path: Path) -> None:
    poses.write(tmp_path / "poses.npz")
    roots = {}
    for place in ("world", "centre", "treadmill"):
        performance = read_performance(tmp_path / "poses.npz", small, poses, place=place)
        moved = performance.vertices(1) - poses.vertices[1]
        np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-5)
        np.testing.assert_allclose(moved[0], performance.motion.translation[1] - poses.translation[1],
                                   atol=1e-5)
        assert abs(moved[0, 1]) < 1e-6
        # A body that is nothing but its pelvis: turned about the origin, then moved.
        joint = (small.joints[0] + small.joint_dirs[0] @ poses.shape).astype(np.float32)
        pelvis = Body(small.faces * 0, small.uv, small.uv_faces, joint[None], joint[None], ("pelvis",),
                      np.array([-1]), np.ones((1, 1)))
        rows = zip(performance.motion.root_rotation, performance.motion.translation, strict=True)
        roots[place] = np.array([skin(pelvis, np.zeros(3), *row).numpy() for row in rows])
    np.testing.assert_allclose(roots["treadmill"][:, [0, 2]], 0, atol=1e-5)
    np.testing.assert_allclose(np.ptp(roots["centre"], axis=0), np.ptp(roots["world"], axis=0), atol=1e-5)
    np.testing.assert_allclose((roots["centre"].min(0) + roots["centre"].max(0))[[0, 2]], 0, atol=1e-5)


def test_clips_by_name_at_any_rate(anny: Body) -> None:
    poses = Poses(np.array([0]), anny.template[None], np.zeros((1, 31, 3)), np.zeros((1, 3)),
                  np.zeros((1, 3)))
    clip = load_clip("walk")
    performance = read_performance("walk", anny, poses, fps=15)
    assert performance.fps == 15 and len(performance) == int(clip.duration * 15 + 1e-3) + 1
    want = retarget(anny, clip, [2 / 15])
    np.testing.assert_allclose(performance.motion.pose[2], want.pose[0], atol=1e-6)


INNER = {smpl: cmu for cmu, smpl in COUNTERPARTS.items()}


def smpl_like(anny: Body) -> tuple[Body, Poses]:
    """The default body's 24 joints that SMPL has, too, called as SMPL calls them; and a pose of it."""
    names = LAYOUTS[24]
    keep = [anny.joint_names.index(INNER[name]) for name in names]
    ancestors = []
    for joint in keep:
        parent = anny.parents[joint]
        while parent >= 0 and parent not in keep:
            parent = anny.parents[parent]
        ancestors.append(keep.index(parent) if parent >= 0 else -1)
    weights = anny.weights[:, keep] + 1e-6
    body = dataclasses.replace(anny, joints=anny.joints[keep], joint_names=names,
                               parents=np.array(ancestors, np.int32),
                               weights=weights / weights.sum(1, keepdims=True), joint_dirs=None)  # fmt: skip
    return body, Poses(np.array([0]), anny.template[None], np.zeros((1, 24, 3)), np.zeros((1, 3)),
                       np.zeros((1, 3)))


def test_a_clip_on_smpls_joints(anny: Body) -> None:
    """The clip turns them as it does under their own names."""
    body, poses = smpl_like(anny)
    have = read_performance("jump", body, poses).motion
    want = retarget(anny, load_clip("jump"))
    np.testing.assert_allclose(have.root_rotation, want.root_rotation, atol=1e-5)
    for name in ("left_knee", "right_shoulder", "left_elbow", "spine2"):
        own = have.pose[50, body.joint_names.index(name)]
        np.testing.assert_allclose(own, want.pose[50, anny.joint_names.index(INNER[name])], atol=1e-5)


@pytest.mark.parametrize("own", ["SMPL's", "numbers"])
def test_a_bvh_with_the_bodys_own_names(anny: Body, tmp_path: Path, own: str) -> None:
    """The same clip with its joints called as the body's, SMPL's or other ones in the same tree: it is played
    just the same.
    """
    body, poses = smpl_like(anny)
    want = read_performance("jump", body, poses).motion
    called = {
        INNER[name]: name if own == "SMPL's" else f"joint{j:02d}" for j, name in enumerate(body.joint_names)
    }
    body = dataclasses.replace(body, joint_names=tuple(called[INNER[name]] for name in body.joint_names))
    text = (Path(bvh.__file__).parent / "data" / "jump.bvh").read_text()
    renamed = re.sub(r"(ROOT|JOINT) (\w+)", lambda found: f"{found[1]} {called.get(found[2], found[2])}",
                     text)
    (tmp_path / "jump.bvh").write_text(renamed)
    have = read_performance(tmp_path / "jump.bvh", body, poses).motion
    for name in ("pose", "root_rotation", "translation"):
        np.testing.assert_array_equal(getattr(have, name), getattr(want, name))


def spoilt(poses: Poses, **changes: np.ndarray) -> dict[str, np.ndarray]:
    return {f.name: getattr(poses, f.name) for f in dataclasses.fields(poses)} | changes


def test_refuses(small: Body, poses: Poses, tmp_path: Path) -> None:
    def refused(message: str, **changes: np.ndarray) -> None:
        np.savez(tmp_path / "poses.npz", **spoilt(poses, **changes))
        with pytest.raises(InputError, match=message):
            read_performance(tmp_path / "poses.npz", small, poses)

    pose = poses.pose.copy()
    pose[3, 2, 1] = np.nan
    refused("pose: found nan at frame 7, joint arm", pose=pose)
    refused(r"pose: .*\(5, 3, 3\); expected \(T, 4, 3\), the run's joints: pelvis, chest, arm, leg",
            pose=pose[:, :3])
    refused("frames: found no frame|at least one",
            **{k: v[:0] for k, v in spoilt(poses).items() if k != "shape"})
    dataclasses.replace(small, joint_names=("pelvis", "chest", "wing", "leg")).write(tmp_path / "body.npz")
    refused(r"pose: found no arm \(but wing\).*; expected the joints of the run's body")
    (tmp_path / "body.npz").unlink()
    bare = Body(small.faces, small.uv, small.uv_faces)
    with pytest.raises(InputError, match="which has no model"):
        poses.write(tmp_path / "poses.npz")
        read_performance(tmp_path / "poses.npz", bare,
                         dataclasses.replace(poses, vertices=poses.vertices[:, :39]))
    with pytest.raises(InputError, match="no skinning model"):
        read_performance("walk", bare, poses)
    with pytest.raises(InputError, match="AMASS-like file"):
        read_performance("walk", small, poses, up="y")


def test_refuses_what_is_no_motion(small: Body, poses: Poses, tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    (tmp_path / "motion.txt").write_text("")
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04")
    for name, message in (("other.npz", "neither poses nor pose"), ("motion.txt", "the ending '.txt'"),
                          ("none.json", "no such file"),
                          ("swim", "one of the clips climb, jump, walk"),
                          ("broken.npz", "damaged")):  # fmt: skip
        with pytest.raises(InputError, match=message):
            read_performance(tmp_path / name if "." in name else name, small, poses)
