"""Time of a warm training step, and whether it compiles anything.

    python benchmarks/training_step.py [CAPTURE] --warm 1100 --steps 200

Trains a new field in a temporary folder with steps of the default size (1,024 rays of 64 candidate samples;
projection, networks, gradients and Adam's update included). Prints the median, the quartiles and the number
of kernels compiled while timing.
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.capture.synthesise.plan import SIZES  # noqa: E402
from ndf_mi.capture.synthesise.synthesise import synthesise  # noqa: E402
from ndf_mi.field import preset  # noqa: E402
from ndf_mi.learn.loop import start  # noqa: E402
from ndf_mi.learn.options import TrainingOptions  # noqa: E402
from ndf_mi.learn.trainer import Trainer  # noqa: E402


@dataclass(frozen=True)
class Options:
    """What is measured."""

    capture: Annotated[Path | None, tyro.conf.Positional] = None
    """A capture's folder; by default the demo's small capture is made in a temporary folder."""

    preset: str = "fast"
    """Architecture."""

    warm: int = 1100
    """Steps before timing begins."""

    steps: int = 200
    """Steps timed."""

    report: int = 0
    """Also time this many steps after step 20, while all of the band is still occupied."""


def main(options: Options) -> None:
    """Measures and prints."""
    with tempfile.TemporaryDirectory() as folder:
        source = options.capture or synthesise(Path(folder) / "capture", SIZES["quick"])
        capture = Capture.read(source)
        trainer = start(
            Path(folder) / "run", capture, preset(options.preset),
            TrainingOptions(steps=options.warm + options.steps),
        )
        print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, {mi.variant()}, "
              f"capture {capture.name}, preset {options.preset}: {trainer.options.rays} rays of "
              f"{trainer.options.samples} candidates")
        for _ in range(20):
            trainer.step()
        if options.report:
            measure(trainer, options.report)
        while trainer.progress.step < options.warm:
            trainer.step()
        measure(trainer, options.steps)


def measure(trainer: Trainer, steps: int) -> None:
    """Times `steps` steps and prints the result."""
    first = trainer.progress.step
    seconds, evaluated, compiled = [], [], 0
    dr.sync_thread()
    for _ in range(steps):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            begun = time.perf_counter()
            trainer.step()
            dr.sync_thread()
            seconds.append(time.perf_counter() - begun)
            compiled += sum(not kernel["cache_hit"] for kernel in dr.kernel_history([dr.KernelType.JIT]))
        evaluated.append(trainer.progress.evaluated)
    low, median, high = np.percentile(seconds, [25, 50, 75])
    print(f"steps {first}-{first + steps}: median {median:.3f} s (quartiles {low:.3f}, {high:.3f}), "
          f"{np.mean(evaluated):.0f} samples in the networks, {compiled} kernels compiled")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
