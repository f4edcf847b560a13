"""Names that were renamed: old options, XML parameters and entries of files keep working for one version.

A command lists its old options in a class attribute ``deprecated``; they are absent from ``--help``::

    deprecated: ClassVar = (
        DeprecatedOption("--lattice", "--grid-spacing"),
        DeprecatedOption("--protocol", "--protocol", {"ours": ("--protocol", "default")}),
        DeprecatedOption("--offsets", "--methods", {"all": (), "none": ("--methods", "ndf,mesh")}),
    )

Old names that a user types warn once, on standard error. Old names in files are read silently.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from ndf_mi.errors import InputError

PRESET_FIELDS: Mapping[str, str] = {"strata": "sample_factor"}
"""Old name → name of fields of :class:`ndf_mi.field.Preset`."""

PRESET_VALUES: Mapping[str, Mapping[Any, str]] = {"coordinates": {"texel": "uv"}}
"""Field of :class:`ndf_mi.field.Preset` → old value → value."""

TRAINING_FIELDS: Mapping[str, str] = {"skip_hidden": "min_transmittance"}
"""Old name → name of fields of :class:`ndf_mi.learn.options.TrainingOptions`."""


@cache
def warn(old: str, new: str) -> None:
    """Prints ``old is deprecated: use new`` on standard error, once a process for each pair of names."""
    print(f"ndf-mi: warning: {old} is deprecated: use {new}", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class DeprecatedOption:
    """An old option that takes a value, or an old value of an option.

    Attributes:
        old: the option, such as ``--offsets``.
        new: the option to use instead; the same where only values were renamed.
        values: old value → the arguments that mean the same today; None where the values are the same.
    """

    old: str
    new: str
    values: Mapping[str, Sequence[str]] | None = None

    def rewrite(self, value: str) -> Sequence[str]:
        """Today's arguments for the option with a value, with a warning where one is old.

        Raises:
            InputError: the old option never had this value.
        """
        if self.values is None:
            warn(self.old, self.new)
            return self.new, value
        if value in self.values:
            warn(f"{self.old} {value}", " ".join(self.values[value]) or f"the default of {self.new}")
            return self.values[value]
        if self.old == self.new:
            return self.old, value
        known = "one of " + ", ".join(self.values)
        raise InputError(self.old, repr(value), known, f"{self.old} is deprecated: use {self.new}.")


def rewrite_arguments(arguments: Sequence[str], options: Sequence[DeprecatedOption]) -> list[str]:
    """A command line with deprecated options replaced by today's, each with a warning.

    Args:
        arguments: ``--name value`` or ``--name=value``; underscores in names count as hyphens.
        options: the command's deprecated options.

    Raises:
        InputError: an old option has a value that it never had, or is given together with the new one.
    """
    def name(argument: str) -> str:
        return argument.partition("=")[0].replace("_", "-")

    known = {option.old: option for option in options}
    rewritten: list[str] = []
    waiting = list(arguments)
    while waiting:
        argument = waiting.pop(0)
        option = known.get(name(argument))
        if option is None or not ("=" in argument or waiting):
            rewritten.append(argument)
            continue
        if option.old != option.new and option.new in map(name, arguments):
            raise InputError(option.old, f"it together with {option.new}", f"{option.new} alone")
        rewritten += option.rewrite(argument.partition("=")[2] if "=" in argument else waiting.pop(0))
    return rewritten


def rename_parameter(props: Any, plugin: str, old: str, new: str) -> None:
    """Moves a parameter in a plugin's ``mi.Properties`` from its old name to its new one, with a warning.

    Raises:
        InputError: both names are given.
    """
    if old not in props:
        return
    if new in props:
        raise InputError(f"{plugin}: {old}", f"it together with {new}", f"{new} alone")
    warn(f"{plugin}: parameter {old}", new)
    props[new] = props[old]
    del props[old]


def rename_entries(
    values: Mapping[str, Any], names: Mapping[str, str],
    contents: Mapping[str, Mapping[Any, str]] | None = None,
) -> dict[str, Any]:
    """Entries read from a file, with old keys and values replaced by new ones. Where an old and its new key
    are there, the new one wins.

    Args:
        names: old key → new key, such as :data:`PRESET_FIELDS`.
        contents: key → old value → new value, such as :data:`PRESET_VALUES`.
    """
    renamed = {names[key]: value for key, value in values.items() if key in names}
    renamed |= {key: value for key, value in values.items() if key not in names}
    for key, replacements in (contents or {}).items():
        if isinstance(renamed.get(key), str):
            renamed[key] = replacements.get(renamed[key], renamed[key])
    return renamed


def rename_entry(name: str, names: Mapping[str, str]) -> str:
    """Today's name of an entry that the user typed, with a warning where `name` is an old one."""
    if name not in names:
        return name
    warn(name, names[name])
    return names[name]
