"""The command line that repeats a call, made of the command's own fields."""

from __future__ import annotations

import dataclasses
import shlex
import typing
from typing import Any

import tyro


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
