"""Collects all issues of a JSON file, where raising an error would stop at the first."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ndf_mi.errors import InputError
from ndf_mi.json_input import is_finite, shown


@dataclass
class Issues:
    """The issues of one file."""

    file: Path
    found: list[InputError] = field(default_factory=list)

    def add(self, key: str, found: str, expected: str, repair: str = "") -> None:
        """Adds an issue with the value of a key, or with the whole file if the key is empty."""
        self.found.append(InputError(f"{self.file}: {key}" if key else self.file, found, expected, repair))

    def number(self, value: Any, key: str, low: float = -math.inf, high: float = math.inf) -> float | None:
        """``value`` as a finite float within [low, high]; otherwise None, with an issue added."""
        if not is_finite(value):
            self.add(key, shown(value), "a finite number")
        elif not low <= value <= high:
            self.add(key, shown(value), f"a number in [{low:g}, {high:g}]")
        else:
            return float(value)
        return None

    def whole(self, value: Any, key: str, expected: str) -> int:
        """``value`` as a whole number above 0; otherwise 1, with an issue added."""
        if type(value) is int and value > 0:
            return value
        self.add(key, shown(value), expected)
        return 1

    def text(self, value: Any, key: str) -> str | None:
        """``value`` if it is text and not empty; otherwise None, with an issue added."""
        if isinstance(value, str) and value:
            return value
        self.add(key, shown(value), "a string")
        return None
