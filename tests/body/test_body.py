"""Body and Poses: what is written is read again; what is wrong is refused by file, key, found and
expected.
"""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import numpy as np
import pytest

from ndf_mi.body import Body, Poses
from ndf_mi.errors import InputError


def poses_of(body: Body, **changed: object) -> dict:
    rng = np.random.default_rng(1)
    pose = rng.normal(size=(3, 4, 3))
    pose[:, 0] = 0
    fields = dict(frames=np.array([2, 3, 7]), vertices=rng.normal(size=(3, 40, 3)), pose=pose,
                  root_rotation=rng.normal(size=(3, 3)), translation=rng.normal(size=(3, 3)),
                  shape=rng.normal(size=2))
    return {**fields, **changed}


class TestBody:
    def test_round_trip(self, small: Body, tmp_path: Path) -> None:
        small.write(tmp_path / "body.npz")
        again = Body.read(tmp_path / "body.npz")
        for field in dataclasses.fields(Body):
            np.testing.assert_array_equal(getattr(again, field.name), getattr(small, field.name))
        assert again.joint_names == small.joint_names
        assert again.faces.dtype == np.int32 and again.uv.dtype == np.float32

    def test_mesh_alone(self, small: Body, tmp_path: Path) -> None:
        Body(small.faces, small.uv, small.uv_faces).write(tmp_path / "body.npz")
        again = Body.read(tmp_path / "body.npz")
        assert again.template is None and not again.skinned and again.joint_count == again.shape_count == 0

    @pytest.mark.parametrize(
        ("key", "spoil", "found"),
        [
            ("faces", lambda a: a[:, :2], r"shape \(20, 2\)"),
            ("faces", lambda a: a + 1, "to 40"),
            ("faces", lambda a: a - 40, "from -"),
            ("faces", lambda a: a.astype(float), "float64"),
            ("uv", lambda a: a + 0.5, "values from"),
            ("uv", lambda a: np.where(a == a[3, 1], np.nan, a), r"nan at \[3, 1\]"),
            ("uv", lambda a: a[:0], "no texture"),
            ("uv_faces", lambda a: a[1:], r"shape \(19, 3\)"),
            ("uv_faces", lambda a: a * 30, "values from"),
            ("template", lambda a: a.astype(str), "type <U"),
            ("joints", lambda a: np.full_like(a, np.inf), "not finite"),
            ("joint_names", lambda a: ("a", "b", "c"), "3 names"),
            ("joint_names", lambda a: ("a", "b", "a", "c"), "a more than once"),
            ("parents", lambda a: np.array([-1, 2, 1, 0]), "joint 1 with the parent 2"),
            ("parents", lambda a: np.array([-1, -1, 1, 0]), "joint 1 with the parent -1"),
            ("weights", lambda a: a * 1.01, "sums to 1.01"),
            ("weights", lambda a: a.T, r"shape \(4, 40\)"),
            ("shape_dirs", lambda a: a[0], r"shape \(3, 2\)"),
            ("pose_dirs", lambda a: a[..., :9], r"shape \(40, 3, 9\)"),
            ("joint_dirs", lambda a: a[..., :1], r"shape \(4, 3, 1\)"),
            ("shape_names", lambda a: ("height",), "1 names"),
        ],
    )
    def test_refuses(self, fields: dict, tmp_path: Path, key: str, spoil, found: str) -> None:
        spoilt = {**fields, key: spoil(fields[key])}
        with pytest.raises(InputError, match=f"body: {key}: found.*{found}"):
            Body(**spoilt)
        path = tmp_path / "somebody.npz"
        np.savez(path, **spoilt)
        with pytest.raises(InputError, match=f"somebody.npz: {key}: found.*{found}"):
            Body.read(path)

    @pytest.mark.parametrize("key", ["faces", "uv", "uv_faces"])
    def test_refuses_a_mesh_without(self, fields: dict, tmp_path: Path, key: str) -> None:
        del fields[key]
        np.savez(tmp_path / "body.npz", **fields)
        with pytest.raises(InputError, match=f"body.npz: {key}: found only"):
            Body.read(tmp_path / "body.npz")


class TestFiles:
    def test_missing(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="body.npz: found no such file"):
            Body.read(tmp_path / "body.npz")

    @pytest.mark.parametrize("keep", [0, 10, 0.3, 0.9, 0.999])
    def test_truncated(self, small: Body, tmp_path: Path, keep: float) -> None:
        path = tmp_path / "body.npz"
        small.write(path)
        whole = path.read_bytes()
        path.write_bytes(whole[: int(keep if keep >= 1 else keep * len(whole))])
        with pytest.raises(InputError, match=r"body.npz: found a damaged or truncated file"):
            Body.read(path)

    def test_damaged_inside(self, small: Body, tmp_path: Path) -> None:
        path = tmp_path / "body.npz"
        small.write(path)
        data = bytearray(path.read_bytes())
        data[60:100] = bytes(40)
        path.write_bytes(data)
        with pytest.raises(InputError, match="damaged or truncated"):
            Body.read(path)

    def test_damaged_header(self, small: Body, tmp_path: Path) -> None:
        """A bracket too few in an array's header ends in tokenize's own error, which is no ValueError."""
        small.write(tmp_path / "whole.npz")
        with (
            zipfile.ZipFile(tmp_path / "whole.npz") as whole,
            zipfile.ZipFile(tmp_path / "body.npz", "w") as damaged,
        ):
            for name in whole.namelist():
                damaged.writestr(name, whole.read(name).replace(b"}", b" ", 1))
        with pytest.raises(InputError, match="body.npz: found a damaged or truncated file"):
            Body.read(tmp_path / "body.npz")

    def test_no_pickle(self, fields: dict, tmp_path: Path) -> None:
        fields["joint_names"] = np.array([print, "a", "b", "c"], dtype=object)
        np.savez(tmp_path / "body.npz", **fields)
        with pytest.raises(InputError, match="joint_names: found Python objects"):
            Body.read(tmp_path / "body.npz")

    def test_npy(self, tmp_path: Path) -> None:
        with open(tmp_path / "body.npz", "wb") as stream:
            np.save(stream, np.zeros(3))
        with pytest.raises(InputError, match="found a single array"):
            Body.read(tmp_path / "body.npz")


class TestPoses:
    def test_round_trip(self, small: Body, tmp_path: Path) -> None:
        poses = Poses(**poses_of(small))
        poses.write(tmp_path / "poses.npz")
        again = Poses.read(tmp_path / "poses.npz", small)
        for field in dataclasses.fields(Poses):
            np.testing.assert_array_equal(getattr(again, field.name), getattr(poses, field.name))
        assert len(again) == 3

    def test_index(self, small: Body) -> None:
        poses = Poses(**poses_of(small))
        assert [poses.index(f) for f in (2, 3, 7)] == [0, 1, 2]
        for frame in (0, 4, 8):
            with pytest.raises(InputError, match=f"found {frame}; expected one of 2-3, 7"):
                poses.index(frame)

    @pytest.mark.parametrize(
        ("key", "value", "found"),
        [
            ("frames", np.array([2, 7, 3]), "ascending"),
            ("frames", np.array([2, 3]), r"vertices: found shape \(3, 40, 3\)"),
            ("frames", np.array([-2, 3, 7]), "from -2"),
            ("vertices", np.zeros((3, 39, 3)), "39 vertices; expected 40"),
            ("vertices", np.full((3, 40, 3), np.nan), r"nan at \[0, 0, 0\]"),
            ("pose", np.zeros((3, 5, 3)), "5 joints; expected 4"),
            ("pose", np.full((3, 4, 3), 0.1), "root entry"),
            ("root_rotation", np.zeros((3, 4)), r"shape \(3, 4\)"),
            ("translation", np.zeros(3), r"shape \(3,\)"),
            ("shape", np.zeros(3), "3 coefficients; expected 2"),
        ],
    )
    def test_refuses(self, small: Body, tmp_path: Path, key: str, value: np.ndarray, found: str) -> None:
        path = tmp_path / "moves.npz"
        np.savez(path, **poses_of(small, **{key: value}))
        with pytest.raises(InputError, match=f"moves.npz: .*{found}"):
            Poses.read(path, small)
