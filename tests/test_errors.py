"""The text of an error about invalid input."""

from __future__ import annotations

from pathlib import Path

from ndf_mi.errors import InputError


def test_names_the_place_what_was_found_and_what_is_expected():
    error = InputError(Path("a") / "b.npz", "shape (3, 2)", "shape (V, 3)")
    assert str(error) == f"{Path('a/b.npz')}: found shape (3, 2); expected shape (V, 3)"
    assert isinstance(error, ValueError)


def test_prints_how_to_repair_it():
    error = InputError("LLVM", "15", "17 or newer", "apt-get install libllvm19")
    assert str(error).splitlines() == ["LLVM: found 15; expected 17 or newer", "  apt-get install libllvm19"]
    assert (error.where, error.found, error.expected, error.repair) == (
        "LLVM",
        "15",
        "17 or newer",
        "apt-get install libllvm19",
    )
