"""How long `import ndf_mi`, which imports Mitsuba, takes compared with `import mitsuba`.

    python benchmarks/import_time.py --repeats 15

Imports each in fresh processes, alternately. Prints the medians of the seconds that `python -X importtime`
reports, and their ratio. Exits with 1 where the ratio is 2 or more.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import tyro

LIMIT = 2.0
"""The ratio must stay below this."""


@dataclass(frozen=True)
class Options:
    """How to measure."""

    repeats: int = 15
    """Imports of each that count, after one that does not."""


def main(options: Options) -> int:
    """Measures and prints; returns 0 where the ratio is below the limit, else 1."""
    names = ("mitsuba", "ndf_mi")
    seconds = np.array([[_import(name) for name in names] for _ in range(options.repeats + 1)])[1:]
    mitsuba, ours = np.median(seconds, axis=0)
    within = bool(ours < LIMIT * mitsuba)
    ratio = f"{ours / mitsuba:.2f} times (median of {options.repeats})"
    print(f"import mitsuba {mitsuba:.3f} s, import ndf_mi {ours:.3f} s: {ratio}")
    print(f"{'within' if within else 'EXCEEDS'} the limit of {LIMIT:g} times")
    return 0 if within else 1


def _import(name: str) -> float:
    """The cumulative seconds on a module's line of the report."""
    command = [sys.executable, "-X", "importtime", "-c", f"import {name}"]
    report = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    for line in report.splitlines():
        own, cumulative, module = line.removeprefix("import time:").split("|")
        if module.strip() == name:
            return int(cumulative) / 1e6
    raise RuntimeError(f"python -X importtime does not report {name}:\n{report}")


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
