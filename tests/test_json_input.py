"""JSON that people wrote: what is wrong with it is reported by file and key."""

from __future__ import annotations

import math
from typing import Annotated

import pytest
from msgspec import Meta, Struct

from ndf_mi.errors import InputError
from ndf_mi.json_input import is_finite, load_json, number, shown, validated


def test_values_are_read(tmp_path):
    (tmp_path / "a.json").write_text('{"a": [1, 2.5]}', encoding="utf-8")
    assert load_json(tmp_path / "a.json", "numbers") == {"a": [1, 2.5]}


@pytest.mark.parametrize("text", ["{", "nothing", "[" * 100_000])
def test_what_is_no_json_is_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"a.json: found .*JSON.*; expected numbers\n  Write it."):
        load_json(tmp_path / "a.json", "numbers", "Write it.")


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(InputError, match=r"a.json: found no such file; expected numbers"):
        load_json(tmp_path / "a.json", "numbers")
    with pytest.raises(InputError, match="directory"):
        load_json(tmp_path, "numbers")


@pytest.mark.parametrize(("value", "finite"), [
    (1, True), (-2.5, True), (10**400, False), (math.nan, False), (math.inf, False), (True, False),
    ("1", False),
    (None, False),
])  # fmt: skip
def test_numbers(value, finite):
    assert is_finite(value) == finite
    if finite:
        assert number(value, "file: key") == float(value)
    else:
        with pytest.raises(InputError, match="file: key"):
            number(value, "file: key")


def test_numbers_below_the_least_are_refused():
    assert number(2, "file: key", low=2) == 2.0
    with pytest.raises(InputError, match="file: key.*1.*2"):
        number(1, "file: key", low=2)


def test_values_in_messages_are_short():
    deep: list = []
    for _ in range(100_000):
        deep = [deep]
    assert shown(None) == "nothing"
    assert shown("a") == '"a"'
    assert len(shown(list(range(1000)))) <= 60
    assert "list" in shown(deep)


class Point(Struct):
    x: float
    name: Annotated[str, Meta(min_length=1)] = "a"


class Path(Struct, forbid_unknown_fields=True):
    points: list[Point]
    closed: bool | None = None


def test_values_become_structs():
    path = validated({"points": [{"x": 1}], "closed": True}, Path, "file: path")
    assert path.points == [Point(1.0)] and path.closed is True


@pytest.mark.parametrize(("value", "facts"), [
    ({"points": [{"x": 1}, {"x": "far"}]}, ["file: path.points[1].x", 'found "far"', "a finite number"]),
    ({"points": [{"name": "b"}]}, ["file: path.points[0].x", "found nothing"]),
    ({"points": [{"x": 10**400}]}, ["file: path.points[0].x", "found 1000", "a finite number"]),
    ({"points": [{"x": 1, "name": ""}]}, ["file: path.points[0].name", 'found ""', "text of length >= 1"]),
    ({"points": {}}, ["file: path.points", "found {}", "a list"]),
    ({"points": [], "closed": 1}, ["file: path.closed", "found 1", "true or false"]),
    ({"points": [], "colour": 1}, ["file: path.colour", "unknown"]),
    ([], ["file: path", "found []", "an object"]),
])  # fmt: skip
def test_what_is_wrong_is_named_with_its_place_and_value(value, facts):
    with pytest.raises(InputError) as raised:
        validated(value, Path, "file: path", "Write it again.")
    assert all(fact in str(raised.value) for fact in facts), str(raised.value)
    assert raised.value.repair == "Write it again."
