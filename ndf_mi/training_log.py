"""`metrics.jsonl` of a run: one JSON object for each logged step of training."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from ndf_mi.errors import InputError

FILE_NAME = "metrics.jsonl"


def read_training_log(run: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """The logged steps of the run in a folder, in order; empty if nothing was logged.

    An incomplete last line, which a training that was killed may leave, is ignored.

    Raises:
        InputError: any other line is not a JSON object.
    """
    file = Path(run) / FILE_NAME
    if not file.is_file():
        return []
    lines = file.read_text(encoding="utf-8").splitlines()
    entries = []
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if isinstance(entry, dict):
            entries.append(entry)
        elif number < len(lines):
            raise InputError(f"{file}:{number}", repr(line[:40]), "one JSON object a line")
    return entries
