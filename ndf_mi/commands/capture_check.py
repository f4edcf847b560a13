"""``ndf-mi capture check``: lists all issues of a capture."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass
class CaptureCheck:
    """Check a capture: list all its issues, or describe its contents if there are none."""

    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The capture's folder."""

    def run(self) -> int:
        """Prints the issues on stderr and returns 2, or prints a summary and returns 0."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.capture.check import problems, summary

        found = problems(self.path)
        for issue in found:
            print(f"ndf-mi: error: {issue}", file=sys.stderr)
        if found:
            print(f"{len(found)} issue{'s' if len(found) > 1 else ''}", file=sys.stderr)
            return 2
        print(summary(Capture.read(self.path)))
        return 0
