"""Collects what is wrong with a JSON file, key by key, where raising would stop at the first."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ndf_mi.errors import InputError
from ndf_mi.json_input import is_finite, shown


@dataclass
class Faults:
    """Collects what is wrong with one file, key by key."""

    file: Path
    found: list[InputError] = field(default_factory=list)

    def add(self, key: str, found: str, expected: str, repair: str = "") -> None:
        self.found.append(InputError(f"{self.file}: {key}" if key else self.file, found, expected, repair))

    def number(self, value: Any, key: str, low: float = -math.inf, high: float = math.inf) -> float | None:
        """``value`` as a finite float within [low, high], or None with the fault noted."""
        if not is_finite(value):
            self.add(key, shown(value), "a finite number")
        elif not low <= value <= high:
            self.add(key, shown(value), f"a number in [{low:g}, {high:g}]")
        else:
            return float(value)
        return None

    def text(self, value: Any, key: str) -> str | None:
        if isinstance(value, str) and value:
            return value
        self.add(key, shown(value), "a string")
        return None
