"""Names that were renamed: old options, XML parameters and entries of files keep working for one version.

A command lists its old options in a class attribute ``deprecated``; they are absent from ``--help``::

    deprecated: ClassVar = (
        RenamedOption("--skip-hidden", "--min-transmittance"),
        RenamedValue("--protocol", "ours", "default"),
        ReplacedOption("--offsets", {"all": (), "none": ("--methods", "ndf,mesh")}, "--methods"),
    )

Old names that a user types warn once, on standard error; old names in files are read silently.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

from ndf_mi.errors import InputError

PRESET_FIELDS: Mapping[str, str] = {"strata": "sample_factor"}
"""Old name → name of fields of :class:`ndf_mi.field.Preset`."""

TRAINING_FIELDS: Mapping[str, str] = {"skip_hidden": "min_transmittance"}
"""Old name → name of fields of :class:`ndf_mi.learn.options.TrainingOptions`."""


@cache
def warn(old: str, new: str) -> None:
    """Prints ``old is deprecated: use new`` on standard error, once a process for each pair of names."""
    print(f"ndf-mi: warning: {old} is deprecated: use {new}", file=sys.stderr, flush=True)


class DeprecatedOption(Protocol):
    """An old form of an option on the command line."""

    def rewrite(self, name: str, value: str | None, arguments: Sequence[str]) -> Sequence[str] | None:
        """The arguments that replace an option, or None where it isn't the old form.

        Args:
            name: the option, such as ``--skip-hidden``, with hyphens.
            value: the argument that follows, or what stands behind ``=``; None where there is none.
            arguments: the whole command line.

        Returns:
            the new option and its value, in the place of `name` and, where the option takes one, `value`.
        """
        ...


@dataclass(frozen=True)
class RenamedOption:
    """``old`` became ``new``; the value means the same."""

    old: str
    new: str
    flag: bool = False
    """Whether the option takes no value; then ``--no-old`` becomes ``--no-new``."""

    def rewrite(self, name: str, value: str | None, arguments: Sequence[str]) -> Sequence[str] | None:
        if self.flag:
            for prefix in ("--", "--no-"):
                if name == prefix + self.old[2:]:
                    warn(name, prefix + self.new[2:])
                    return [prefix + self.new[2:]]
            return None
        if name != self.old:
            return None
        _refuse_both(self.old, self.new, arguments)
        warn(self.old, self.new)
        return [self.new] if value is None else [self.new, value]


@dataclass(frozen=True)
class RenamedValue:
    """The value ``old`` of ``option`` became ``new``."""

    option: str
    old: str
    new: str

    def rewrite(self, name: str, value: str | None, arguments: Sequence[str]) -> Sequence[str] | None:
        if name != self.option or value != self.old:
            return None
        warn(f"{self.option} {self.old}", f"{self.option} {self.new}")
        return [self.option, self.new]


@dataclass(frozen=True)
class ReplacedOption:
    """An option that another one replaced."""

    old: str
    values: Mapping[str, Sequence[str]]
    """Value of `old` → the arguments that now mean the same."""
    new: str
    """The option to use instead."""

    def rewrite(self, name: str, value: str | None, arguments: Sequence[str]) -> Sequence[str] | None:
        if name != self.old:
            return None
        _refuse_both(self.old, self.new, arguments)
        if value is None or value not in self.values:
            raise InputError(
                self.old,
                "no value" if value is None else repr(value),
                "one of " + ", ".join(self.values),
                f"{self.old} is deprecated: use {self.new}.",
            )
        replacement = self.values[value]
        warn(f"{self.old} {value}", " ".join(replacement) or f"{self.new}, whose default is the same")
        return replacement


def rewrite_arguments(arguments: Sequence[str], options: Iterable[DeprecatedOption]) -> list[str]:
    """A command line with deprecated options replaced by today's, each with a warning.

    Args:
        arguments: of a command, ``--name value`` or ``--name=value``; underscores in names count as hyphens.
        options: the command's deprecated options.

    Raises:
        InputError: an old option has a value that it never had, or is given together with the new one.
    """
    options = tuple(options)
    rewritten: list[str] = []
    index = 0
    while index < len(arguments):
        argument = arguments[index]
        if not argument.startswith("--") or argument == "--":
            rewritten.append(argument)
            index += 1
            continue
        inline = "=" in argument
        name = _name(argument)
        following = arguments[index + 1] if index + 1 < len(arguments) else None
        value = argument.partition("=")[2] if inline else following
        for option in options:
            replacement = option.rewrite(name, value, arguments)
            if replacement is not None:
                takes_value = not (isinstance(option, RenamedOption) and option.flag) and value is not None
                rewritten += replacement
                index += 1 + (takes_value and not inline)
                break
        else:
            rewritten.append(argument)
            index += 1
    return rewritten


def rename_parameter(props: Any, plugin: str, old: str, new: str) -> None:
    """Moves a plugin's XML parameter from its old name to its new one, with a warning.

    Args:
        props: the plugin's ``mi.Properties``.
        plugin: the plugin's name, for messages.

    Raises:
        InputError: both names are given.
    """
    if old not in props:
        return
    if new in props:
        raise InputError(
            f"{plugin}: {old}", f"it together with {new}", f"{new} alone", f"{old} is the old name of {new}."
        )
    warn(f"{plugin}: parameter {old}", new)
    props[new] = props[old]
    del props[old]


def rename_entries(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Entries read from a file, with old keys replaced by new ones. Where both are there, the new one wins.

    Args:
        names: old key → new key, such as :data:`PRESET_FIELDS`.
    """
    return {names[key]: value for key, value in values.items() if key in names} | {
        key: value for key, value in values.items() if key not in names
    }


def rename_entry(name: str, names: Mapping[str, str]) -> str:
    """Today's name of an entry that the user typed, with a warning where `name` is an old one."""
    if name not in names:
        return name
    warn(name, names[name])
    return names[name]


def _refuse_both(old: str, new: str, arguments: Sequence[str]) -> None:
    if new in map(_name, arguments):
        raise InputError(old, f"it together with {new}", f"{new} alone", f"{old} is deprecated.")


def _name(argument: str) -> str:
    return argument.partition("=")[0].replace("_", "-")
