"""Properties that several of the package's integrators read."""

from __future__ import annotations

from collections.abc import Collection

import mitsuba as mi

from ndf_mi.errors import InputError


def count(props: mi.Properties, plugin: str, name: str, default: int) -> int:
    """A property that must be a whole number above 0. Raises InputError otherwise."""
    value = int(props.get(name, default))
    if value < 1:
        raise InputError(f"{plugin}: {name}", str(value), "a whole number above 0")
    return value


def aovs(props: mi.Properties, plugin: str, known: Collection[str]) -> list[str]:
    """The names in the property `aovs`, separated by commas. Raises InputError for one that is not in
    `known`."""
    names = [name.strip() for name in str(props.get("aovs", "")).split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise InputError(f"{plugin}: aovs", repr(name), ", ".join(known))
    return names
