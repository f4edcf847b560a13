"""Reads JSON that people or other programs wrote; errors name the file and the key."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import msgspec

from ndf_mi.errors import InputError

T = TypeVar("T")


def load_json(path: Path) -> Any:
    """The value in a JSON file.

    Raises:
        FileNotFoundError: no such file.
        ValueError: the file cannot be read, is not JSON, or is nested too deep for Python's reader.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from None
    except RecursionError:
        raise ValueError("nested too deep") from None


def is_finite(value: Any) -> TypeGuard[int | float]:
    """Whether a JSON value is a number that fits into a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def number(value: Any, where: str, low: float = -math.inf) -> float:
    """A JSON value as a finite float.

    Raises:
        InputError: at `where`, if it is not a number, not finite, or below `low`.
    """
    if is_finite(value) and value >= low:
        return float(value)
    raise InputError(where, shown(value),
                     "a finite number" + (f" of at least {low:g}" if low > -math.inf else ""))


def shown(value: Any) -> str:
    """A value for a message: shortened, and ``nothing`` for a missing key."""
    if value is None:
        return "nothing"
    try:
        text = json.dumps(value, default=str)
    except RecursionError:
        text = f"a deeply nested {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


def validated(value: Any, kind: type[T], where: str, repair: str = "") -> T:
    """JSON values as an instance of `kind`, a msgspec Struct or another type that msgspec knows.

    Raises:
        InputError: a value is missing, is of another type or unknown; its place is named behind `where`.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at `$")
        place = place.rstrip("`")
        wrong = re.fullmatch("Expected `(.*)`, got `(.*)`", text)
        missing = re.fullmatch("Object missing required field `(.*)`", text)
        found, expected = text[:1].lower() + text[1:], "a value of this format"
        if wrong:
            expected, found = wrong.groups()
        if missing:
            place, found, expected = f"{place}.{missing[1]}", "nothing", "a value"
        at = place.lstrip(".") if ": " not in where else place
        raise InputError(f"{where}: {at}" if at != place else where + at, found, expected, repair) from None
