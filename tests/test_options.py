"""Options read from JSON values have their types, and mistakes are named."""

import dataclasses
from typing import Literal

import pytest

from ndf_mi.errors import InputError
from ndf_mi.options import read_options


@dataclasses.dataclass(frozen=True)
class Example:
    count: int = 1
    width: float = 0.5
    quiet: bool = False
    name: str = "a"
    kind: Literal["one", "two"] = "one"
    layers: tuple[int, ...] = ()
    parts: tuple[str, ...] = ()

    def __post_init__(self):
        if self.count < 1:
            raise InputError("count", str(self.count), "at least 1")


def test_values_have_the_types_of_their_options():
    found = read_options(Example, {"width": 2, "layers": [8, 4], "quiet": True, "kind": "two"}, "file")
    assert found == Example(width=2.0, layers=(8, 4), quiet=True, kind="two")
    assert type(found.width) is float and type(found.layers) is tuple


@pytest.mark.parametrize(("values", "facts"), [
    ({"sky": 1}, ["file", "sky", "count", "layers"]),
    ({"count": 1.5}, ["file", "count", "1.5", "whole number"]),
    ({"count": True}, ["file", "count", "true"]),
    ({"quiet": 1}, ["file", "quiet", "true or false"]),
    ({"layers": [1, 2.5]}, ["file", "layers", "list of whole numbers"]),
    ({"parts": [1]}, ["file", "parts", "list of names"]),
    ({"kind": "three"}, ["file", "kind", "three", "one, two"]),
    ({"name": 3}, ["file", "name", "3"]),
    ({"count": 0}, ["file", "count", "0", "at least 1"]),
])
def test_mistakes_are_named(values, facts):
    with pytest.raises(InputError) as caught:
        read_options(Example, values, "file")
    for fact in facts:
        assert fact in str(caught.value)
