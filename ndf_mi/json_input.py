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

_KINDS = {"int": "a whole number", "float": "a finite number", "str": "text", "bool": "true or false",
          "array": "a list", "object": "an object"}
"""The types in messages of msgspec, as other messages name them."""


def load_json(path: Path, expected: str, repair: str = "") -> Any:
    """The value in a JSON file.

    Raises:
        InputError: with what is `expected`, if there is no such file, or it cannot be read, is not JSON, or
        is nested too deep for Python's reader.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(path, "no such file", expected, repair) from None
    except (OSError, ValueError, RecursionError) as error:
        why = "nested too deep" if isinstance(error, RecursionError) else getattr(error, "strerror", error)
        raise InputError(path, f"a file that cannot be read as JSON ({why})", expected, repair) from None


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
        InputError: a value is missing, is of another type or out of range; its place follows `where`.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at `$")
        place = place.rstrip("`")
        missing = re.fullmatch("Object missing required field `(.*)`", text)
        unknown = re.fullmatch("Object contains unknown field `(.*)`", text)
        if missing:
            place, found, expected = f"{place}.{missing[1]}", "nothing", "a value"
        elif unknown:
            place, found, expected = f"{place}.{unknown[1]}", "an unknown key", "keys of this format only"
        elif text == "Number out of range":
            found, expected = shown(_at(value, place)), "a finite number"
        elif text.startswith("Expected "):
            expected, _, got = text.removeprefix("Expected ").partition(", got ")
            # msgspec does not name the keys of dicts.
            found = got.strip("`") if got and "[...]" in place else shown(_at(value, place))
            expected = re.sub("`(.*?)`", _in_words, expected)
        else:
            found, expected = f"{text[:1].lower()}{text[1:]}", "a value of this format"
        at = place.lstrip(".") if ": " not in where else place
        raise InputError(f"{where}: {at}" if at != place else where + at, found, expected, repair) from None


def _in_words(kinds: re.Match[str]) -> str:
    """Types such as ``object | null`` in words; null is left out, since a key may be missing."""
    return " or ".join(_KINDS.get(kind, kind) for kind in kinds[1].split(" | ") if kind != "null")


def _at(value: Any, place: str) -> Any:
    """The value at a place in JSON, such as ``.cameras[0].name``; the innermost that can be found."""
    for key, index in re.findall(r"\.([^.\[]+)|\[(\d+)\]", place):
        try:
            value = value[key] if key else value[int(index)]
        except (KeyError, IndexError, TypeError):
            break
    return value
