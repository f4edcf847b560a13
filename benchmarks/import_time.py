"""How long `import ndf_mi` takes beside `import mitsuba`, each in fresh processes, one after the other.

    python benchmarks/import_time.py --repeats 15

Prints the medians of the seconds that `python -X importtime` tells for each, their ratio, and whether it stays below 2, as is promised:
where it does not, the exit status is 1. Importing ndf_mi imports Mitsuba.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import tyro

PROMISED = 2.0
"""Times that importing ndf_mi may take of importing Mitsuba."""


@dataclass(frozen=True)
class Options:
    """What is measured."""

    repeats: int = 15
    """Processes started of each; the first of each is not counted."""


def main(options: Options) -> int:
    """Measures and prints; 0 where the promise is kept, 1 where not."""
    names = ("mitsuba", "ndf_mi")
    seconds = np.array([[_import(name) for name in names] for _ in range(options.repeats + 1)])[1:]
    mitsuba, ours = np.median(seconds, axis=0)
    kept = bool(ours < PROMISED * mitsuba)
    print(f"import mitsuba {mitsuba:.3f} s, import ndf_mi {ours:.3f} s: {ours / mitsuba:.2f} times (median of {options.repeats})")
    print(f"{'kept' if kept else 'MISSED'}: less than {PROMISED:g} times Mitsuba's own")
    return 0 if kept else 1


def _import(name: str) -> float:
    """The cumulative seconds of a module's line in the report."""
    report = subprocess.run([sys.executable, "-X", "importtime", "-c", f"import {name}"], capture_output=True, text=True, check=True).stderr
    for line in report.splitlines():
        own, cumulative, module = line.removeprefix("import time:").split("|")
        if module.strip() == name:
            return int(cumulative) / 1e6
    raise RuntimeError(f"python -X importtime says nothing of {name}:\n{report}")


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
