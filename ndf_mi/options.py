"""Dataclasses of options from JSON values: unknown names and wrong types are reported by name."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from ndf_mi.errors import InputError
from ndf_mi.json_input import shown

T = TypeVar("T")

_KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "a text",
          tuple: "a list of whole numbers such as [64,64]"}


def option_value(options: type, name: str, value: Any, where: str) -> Any:
    """A JSON value as the type of the option ``name`` of a dataclass; lists become tuples, and whole numbers
    are numbers.

    Raises:
        InputError: at ``where``: there is no such option, or the value has another type.
    """
    hints = get_type_hints(options)
    if name not in hints:
        raise InputError(where, f"the option {name!r}", "one of " + ", ".join(sorted(hints)))
    try:
        return msgspec.convert(value, hints[name])
    except msgspec.ValidationError:
        kind = get_origin(hints[name]) or hints[name]
        if hints[name] == tuple[str, ...]:
            raise InputError(f"{where}: {name}", shown(value), 'a list of names such as ["pose"]') from None
        expected = _KINDS.get(kind) or "one of " + ", ".join(map(str, get_args(hints[name])))
        raise InputError(f"{where}: {name}", shown(value), expected) from None


def read_options(options: type[T], values: dict[str, Any], where: str) -> T:
    """An instance of the dataclass `options` from JSON values; missing entries have its defaults.

    Raises:
        InputError: at ``where``: an entry does not exist, has another type, or is refused by the dataclass.
    """
    assert dataclasses.is_dataclass(options)
    converted = {name: option_value(options, name, value, where) for name, value in values.items()}
    try:
        return options(**converted)
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.found, error.expected) from None
