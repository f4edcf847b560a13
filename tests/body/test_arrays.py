"""Checked arrays from values that others wrote."""

from __future__ import annotations

import numpy as np
import pytest

from ndf_mi.body import arrays
from ndf_mi.errors import InputError


def test_nested_lists_and_arrays_become_arrays() -> None:
    np.testing.assert_array_equal(arrays.regular("a: b", [[1, 2.5], (3, 4)]), [[1, 2.5], [3, 4]])
    np.testing.assert_array_equal(arrays.regular("a: b", [np.arange(2), np.arange(2)]), [[0, 1], [0, 1]])
    held = np.arange(3)
    assert arrays.regular("a: b", held) is held


@pytest.mark.parametrize(("value", "fact"), [
    ([[1, 2], [3]], "unequal length"),
    ([1, "x" * 1_000_000] + 100_000 * ["y"], "something else than numbers"),  # 400 GB as an array of text
    ([None], "something else than numbers"),
    ([[1, [2, {}]]], "something else than numbers"),
])  # fmt: skip
def test_other_lists_are_refused(value: object, fact: str) -> None:
    with pytest.raises(InputError, match=f"a: b: found .*{fact}"):
        arrays.regular("a: b", value)
