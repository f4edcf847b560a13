"""Collects all issues of a JSON file, where raising an error would stop at the first."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ndf_mi.errors import InputError
from ndf_mi.json_input import validated


@dataclass
class Issues:
    """The issues of one file."""

    file: Path
    found: list[InputError] = field(default_factory=list)

    def add(self, key: str, found: str, expected: str, repair: str = "") -> None:
        """Adds an issue with the value of a key, or with the whole file if the key is empty."""
        self.found.append(InputError(f"{self.file}: {key}" if key else self.file, found, expected, repair))

    def read(self, value: Any, kind: Any, key: str) -> Any:
        """The value of a key as a type that msgspec knows; otherwise None, with an issue added."""
        try:
            return validated(value, kind, f"{self.file}: {key}")
        except InputError as error:
            self.found.append(error)
            return None
