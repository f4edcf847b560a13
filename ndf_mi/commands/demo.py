"""``ndf-mi demo``: the whole line on a small capture."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass
class Demo:
    """Make a small capture, train a field on it, compare it with textured meshes and write report.html. What an earlier call has
    finished is kept; a stopped one goes on.

    The textured mesh is trained until its loss stops falling (once more for the field's time where that takes longer),
    the one with vertex offsets for the field's time.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("demo")
    """The folder for the capture, the run and the report."""

    seconds: float = 150.0
    """Time to train the field for, and the mesh with offsets; a field that an earlier call has begun keeps what it was begun with."""

    seed: int = 0
    """Of the capture, the training and the comparison."""

    def run(self) -> int:
        """Runs the three commands, one after another."""
        from ndf_mi.capture.check import problems
        from ndf_mi.commands.capture_synthesise import CaptureSynthesise
        from ndf_mi.commands.compare import Compare
        from ndf_mi.commands.optimise import Optimise

        started = time.perf_counter()
        capture, run = self.out / "capture", self.out / "run"
        damaged = (capture / "capture.json").exists() and bool(problems(capture))
        if damaged or not (capture / "capture.json").exists():
            _say(f"1/3  a capture of a synthetic performer: {capture}")
            CaptureSynthesise(out=capture, size="quick", seed=self.seed, overwrite=damaged).run()
        if (run / "config.json").exists():
            _say(f"2/3  going on with the field: {run}")
            Optimise(capture=capture, out=run, resume=True).run()
        else:
            _say(f"2/3  training a field for {self.seconds:.0f} s: {run}")
            Optimise(capture=capture, out=run, seconds=self.seconds, seed=self.seed).run()
        _say("3/3  training the textured meshes, comparing all on held-out views and poses")
        Compare(run_folder=run, capture=capture, out=self.out, seed=self.seed, offsets="equal-time").run()
        _say(f"done in {time.perf_counter() - started:.0f} s: open {self.out / 'report.html'}")
        return 0


def _say(text: str) -> None:
    print(f"\n== {text}", flush=True)
