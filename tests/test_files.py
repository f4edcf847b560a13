"""A file is there whole or not at all."""

from __future__ import annotations

import json
import os
import stat

import numpy as np
import pytest

from ndf_mi import files


def test_replaces_only_on_success(tmp_path):
    target = tmp_path / "new" / "folder" / "picture.png"
    with files.replacing(target) as temporary:
        assert temporary.suffix == ".png" and temporary.parent == target.parent
        temporary.write_bytes(b"one")
        assert not target.exists()
    assert target.read_bytes() == b"one"
    with pytest.raises(RuntimeError, match="halfway"):
        with files.replacing(target) as temporary:
            temporary.write_bytes(b"tw")
            raise RuntimeError("halfway")
    assert target.read_bytes() == b"one"
    assert os.listdir(target.parent) == ["picture.png"]


def test_permissions_are_those_of_a_plain_file(tmp_path):
    (tmp_path / "plain").write_text("")
    files.write_text(tmp_path / "ours", "")
    assert stat.S_IMODE((tmp_path / "ours").stat().st_mode) == stat.S_IMODE(
        (tmp_path / "plain").stat().st_mode
    )


def test_text_and_json(tmp_path):
    files.write_text(tmp_path / "a.txt", "σ_t\n")
    assert (tmp_path / "a.txt").read_bytes() == "σ_t\n".encode()
    files.write_json(tmp_path / "a.json", {"a": [1, 2.5, None]})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [1, 2.5, None]}
    with pytest.raises(ValueError):
        files.write_json(tmp_path / "b.json", float("nan"))
    assert not (tmp_path / "b.json").exists()


def test_npz_holds_the_arrays_and_nothing_else(tmp_path):
    files.write_npz(tmp_path / "a.npz", x=np.arange(3), names=np.array(["a", "bc"]))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert sorted(archive.files) == ["names", "x"]
        assert archive["x"].tolist() == [0, 1, 2] and archive["names"].tolist() == ["a", "bc"]
    with pytest.raises(ValueError):
        files.write_npz(tmp_path / "b.npz", x=np.array([object()]))
    assert os.listdir(tmp_path) == ["a.npz"]
