"""The exception for invalid input. Commands print it and exit with code 2."""

from __future__ import annotations

import os


class InputError(ValueError):
    """Something that the user gave cannot be used.

    Args:
        where: the file, key or option, as the user would name it.
        found: what is there.
        expected: what would be valid.
        repair: optional: how to repair it, a sentence or a command.
    """

    def __init__(self, where: str | os.PathLike[str], found: str, expected: str, repair: str = "") -> None:
        self.where = os.fspath(where)
        self.found = found
        self.expected = expected
        self.repair = repair
        text = f"{self.where}: found {found}; expected {expected}"
        super().__init__(f"{text}\n  {repair}" if repair else text)
