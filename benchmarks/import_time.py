"""How long `import ndf_mi` takes beside `import mitsuba`, each in fresh processes, one after the other.

    python benchmarks/import_time.py --repeats 15

Prints the medians of the seconds that `python -X importtime` tells for each, and their ratio, which is promised to stay below 2. Importing
ndf_mi imports Mitsuba.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import tyro


@dataclass(frozen=True)
class Options:
    """What is measured."""

    repeats: int = 15
    """Processes started of each; the first of each is not counted."""


def main(options: Options) -> None:
    """Measures and prints."""
    names = ("mitsuba", "ndf_mi")
    seconds = np.array([[_import(name) for name in names] for _ in range(options.repeats + 1)])[1:]
    mitsuba, ours = np.median(seconds, axis=0)
    print(f"import mitsuba {mitsuba:.3f} s, import ndf_mi {ours:.3f} s: {ours / mitsuba:.2f} times (median of {options.repeats})")


def _import(name: str) -> float:
    """The cumulative seconds of a module's line in the report."""
    report = subprocess.run([sys.executable, "-X", "importtime", "-c", f"import {name}"], capture_output=True, text=True, check=True).stderr
    for line in report.splitlines():
        own, cumulative, module = line.removeprefix("import time:").split("|")
        if module.strip() == name:
            return int(cumulative) / 1e6
    raise RuntimeError(f"python -X importtime says nothing of {name}:\n{report}")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
