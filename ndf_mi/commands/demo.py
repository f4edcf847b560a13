"""``ndf-mi demo``: synthesises a small capture, trains a field on it, compares it with textured meshes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass
class Demo:
    """Synthesise a small capture, train a field on it, compare it with textured meshes and write report.html.

    Finished parts are kept: repeat the command after an interrupt and it continues. The textured mesh is
    trained until its loss stops falling, the mesh with vertex offsets for as long as the field.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("demo")
    """Folder for the capture, the run and the report."""

    seconds: float = 150.0
    """Training time of the field. A field that is already begun keeps its own."""

    seed: int = 0
    """Seed of the capture, the training and the comparison."""

    def run(self) -> int:
        """Runs the three commands one after another."""
        from ndf_mi.capture.check import problems
        from ndf_mi.commands.capture_synthesise import CaptureSynthesise
        from ndf_mi.commands.compare import Compare
        from ndf_mi.commands.optimise import Optimise

        started = time.perf_counter()
        capture, run = self.out / "capture", self.out / "run"
        exists = (capture / "capture.json").exists()
        damaged = exists and bool(problems(capture))
        if damaged or not exists:
            _print_step(f"1/3  synthesising a capture: {capture}")
            CaptureSynthesise(out=capture, size="quick", seed=self.seed, overwrite=damaged).run()
        if (run / "config.json").exists():
            _print_step(f"2/3  continuing the training of the field: {run}")
            Optimise(capture=capture, out=run, resume=True).run()
        else:
            _print_step(f"2/3  training a field for {self.seconds:.0f} s: {run}")
            Optimise(capture=capture, out=run, seconds=self.seconds, seed=self.seed).run()
        _print_step("3/3  training textured meshes, comparing all on held-out views and poses")
        methods = "ndf,mesh,offset-mesh@equal-time"
        Compare(target=run, capture=capture, out=self.out, seed=self.seed, methods=methods).run()
        _print_step(f"done in {time.perf_counter() - started:.0f} s: open {self.out / 'report.html'}")
        return 0


def _print_step(text: str) -> None:
    print(f"\n== {text}", flush=True)
