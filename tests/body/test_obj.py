"""Wavefront OBJ as various programs write it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ndf_mi.body.obj import read_obj

PLAIN = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 2 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
g first
f 1/1 2/2 3/3
g second
f 1/1/1 2/2/1 3/3/1 4/4/1
"""


def read(tmp_path: Path, text: str):
    file = tmp_path / "mesh.obj"
    file.write_text(text)
    return read_obj(file)


def test_groups_and_the_shorter_diagonal(tmp_path: Path) -> None:
    vertices, uv, groups = read(tmp_path, PLAIN)
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 2, 0]])
    np.testing.assert_array_equal(uv, [[0, 0], [1, 0], [1, 1], [0, 1]])
    assert groups["first"].faces.tolist() == groups["first"].uv_faces.tolist() == [[0, 1, 2]]
    assert groups["second"].faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("change", [
    lambda text: text.replace(" ", "\t"),
    lambda text: "".join(f"  {line}\n" for line in text.splitlines()),
    lambda text: "".join(f"{line} # said aloud\n" for line in text.splitlines()),
    lambda text: text.replace("1/1 2/2 3/3\n", "-4/-4 -3/-3 -2/-2\n"),
    lambda text: "# a comment\n\no object\ns off\nvn 0 0 1\n" + text,
],
ids=["tabs", "leading spaces", "comments at ends of lines", "negative indices", "other lines"])  # fmt: skip
def test_other_ways_to_write_the_same(tmp_path: Path, change) -> None:
    plain, found = read(tmp_path, PLAIN), read(tmp_path, change(PLAIN))
    np.testing.assert_array_equal(found[0], plain[0])
    np.testing.assert_array_equal(found[1], plain[1])
    assert {name: group.faces.tolist() for name, group in found[2].items()} == {
        name: group.faces.tolist() for name, group in plain[2].items()}


@pytest.mark.parametrize(("line", "fault"), [
    ("f 1 2 3", "texture coordinates"),
    ("f 1//1 2//1 3//1", "texture coordinates"),
    ("f 1/1 2/2", "2 corners"),
    ("f 1/1 2/2 3/3 4/4 1/1", "5 corners"),
    ("f 0/1 2/2 3/3", "0/1"),
    ("f -5/-1 2/2 3/3", "-5/-1"),
    ("f a/b 2/2 3/3", "a"),
    ("v 1 2", "values"),
])  # fmt: skip
def test_what_is_wrong_is_named_with_its_line(tmp_path: Path, line: str, fault: str) -> None:
    with pytest.raises(ValueError, match=f"line 13: .*{fault}"):
        read(tmp_path, PLAIN + line)
