"""Reading a dataclass of options back from JSON: unknown names and wrong kinds are the user's mistake, told by name."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

from ndf_mi.errors import InputError

T = TypeVar("T")


def read_options(default: T, values: dict[str, Any], where: str) -> T:
    """An instance of `default`'s dataclass with `values`; entries that are missing have the class's defaults.

    Args:
        default: an instance whose entries say what kind each is; lists stand for tuples, whole numbers may stand for numbers.
        values: the entries, as JSON has them.
        where: the file and key they come from.

    Raises:
        InputError: an entry does not exist, is of another kind, or is refused by the dataclass itself.
    """
    known = {field.name for field in dataclasses.fields(default)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - known)
    if unknown:
        raise InputError(where, f"the option {unknown[0]!r}", "one of " + ", ".join(sorted(known)))
    cleaned: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    for key, value in cleaned.items():
        kind = type(getattr(default, key))
        if not isinstance(value, kind) and not (kind is float and isinstance(value, int)):
            raise InputError(f"{where}: {key}", repr(value), f"a {kind.__name__}")
    try:
        return type(default)(**cleaned)
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.found, error.expected) from None
