"""JSON that people wrote: what is wrong with it is reported by file and key."""

from __future__ import annotations

import math

import pytest

from ndf_mi.errors import InputError
from ndf_mi.json_input import is_finite, load_json, number, shown


def test_values_are_read(tmp_path):
    (tmp_path / "a.json").write_text('{"a": [1, 2.5]}', encoding="utf-8")
    assert load_json(tmp_path / "a.json") == {"a": [1, 2.5]}


@pytest.mark.parametrize("text", ["{", "nothing", "[" * 100_000])
def test_what_is_no_json_is_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError):
        load_json(tmp_path / "a.json")


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_json(tmp_path / "a.json")
    with pytest.raises(ValueError):
        load_json(tmp_path)


@pytest.mark.parametrize(("value", "finite"), [
    (1, True), (-2.5, True), (10**400, False), (math.nan, False), (math.inf, False), (True, False), ("1", False), (None, False),
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
