"""What commands share: the ranges of their options, and the command line that repeats a call."""

from __future__ import annotations

import dataclasses
import math
import shlex
import typing
from collections.abc import Callable, Mapping
from typing import Any

import tyro

from ndf_mi.errors import InputError

_WHOLE = (lambda value: value >= 1), "a whole number above 0"
_FINITE = math.isfinite, "a finite number"
RANGES: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "size": (lambda value: min(value) >= 1, "two whole numbers above 0"),
    "samples": _WHOLE,
    "spp": _WHOLE,
    "cutoff": (lambda value: 0 <= value < 1, "a transmittance in [0, 1)"),
    "fps": (lambda value: 0 < value < math.inf, "frames a second, above 0"),
    "background": (lambda value: all(0 <= v <= 1 for v in value), "three numbers in [0, 1]"),
    "elevation": (lambda value: -90 < value < 90, "degrees between -90 and 90"),
    "turns": _FINITE,
    "azimuth": _FINITE,
}
"""Option → whether a value is valid, and what is expected."""


def check_ranges(command: Any) -> None:
    """Raises InputError unless all options of `RANGES` that a command has and that are given are valid."""
    for name, (valid, expected) in RANGES.items():
        value = getattr(command, name, None)
        if value is not None and not valid(value):
            found = " ".join(f"{v:g}" for v in (value if isinstance(value, tuple) else (value,)))
            raise InputError(f"--{name}", found, expected)


def command_line(name: str, command: Any) -> str:
    """`ndf-mi NAME …` as a shell takes it; options at their defaults are left out.

    Args:
        name: the command's words.
        command: an instance of its dataclass.
    """
    hints = typing.get_type_hints(type(command), include_extras=True)
    fields = [field for field in dataclasses.fields(command) if getattr(command, field.name) != field.default]
    positional = [field for field in fields if _has(hints[field.name], tyro.conf.Positional)]
    words = ["ndf-mi", *name.split(), *(str(getattr(command, field.name)) for field in positional)]
    for field in fields:
        if field in positional:
            continue
        option, value = f"--{field.name.replace('_', '-')}", getattr(command, field.name)
        if isinstance(value, bool):
            words.append(option if value else f"--no-{option[2:]}")
        elif isinstance(value, tuple) and _has(hints[field.name], tyro.conf.UseAppendAction):
            words += [word for item in value for word in (option, str(item))]
        else:
            words += [option, *map(str, value if isinstance(value, tuple) else [value])]
    return shlex.join(words)


def _has(hint: Any, marker: Any) -> bool:
    """Whether an annotation holds one of tyro's markers."""
    return any(mark is marker for mark in typing.get_args(hint)[1:])
