"""``ndf-mi ablate``: what each part of the method is worth on a capture."""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ndf_mi.errors import InputError


@dataclass
class Ablate:
    """Train the full model and every ablation of it, measure them on held-out views and poses, write the table and report.html.

    Stop it when you like: the same command goes on where it was, in the middle of a training too.
    """

    capture: Annotated[Path, tyro.conf.Positional]
    """The capture's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for a run a variant, the table and the report."""

    only: tuple[str, ...] = ()
    """The variants to train, the full model always among them; all by default."""

    preset: str = "fast"
    """Architecture of the full model: fast, paper or tiny."""

    steps: int | None = None
    """Steps of each training."""

    seconds: float | None = None
    """Time for each training, in place of a number of steps."""

    seed: int = 0
    """Of weights, rays and jitter, and of the choice of images."""

    max_images: int = 48
    """Images measured of the novel views, and of the novel poses."""

    sequence: int = 12
    """Successive frames of each split on which temporal consistency is measured; 0 for none."""

    samples: int = 128
    """Candidate samples a ray."""

    def run(self) -> None:
        """Trains and measures what is missing, prints the table and says where the report is."""
        from ndf_mi.compare.ablation import REPORT, Settings, Study
        from ndf_mi.compare.ablation_report import markdown
        from ndf_mi.compare.report import command_line
        from ndf_mi.field import preset
        from ndf_mi.learn.ablations import ABLATIONS
        from ndf_mi.learn.options import TrainingOptions

        if self.seconds is not None and not self.seconds > 0:
            raise InputError("--seconds", f"{self.seconds:g}", "a time above 0")
        options = TrainingOptions.paper() if self.preset == "paper" else TrainingOptions()
        changes: dict[str, float] = {"seed": self.seed}
        if self.seconds is not None:
            changes |= {"seconds": self.seconds, "steps": 10**9}
        if self.steps is not None:
            changes["steps"] = self.steps
        study = Study(self.capture, self.out, self.only or tuple(ABLATIONS), preset(self.preset),
                      dataclasses.replace(options, **changes),  # type: ignore[arg-type]
                      Settings(self.max_images, self.sequence, self.samples, self.seed), command_line(self._arguments()))
        terminal = sys.stderr.isatty()

        def measured(title: str, done: int, of: int) -> None:
            if terminal or done == of:
                print(f"\rmeasured {title}: {done} of {of} images", end="\n" if done == of else "", file=sys.stderr, flush=True)

        results = study.run(lambda name, number, of: print(f"{number} of {of}: {name}", file=sys.stderr, flush=True), measured)
        print(markdown(results), end="")
        print(f"\n{self.out / REPORT}")

    def _arguments(self) -> list[str]:
        """The options that repeat this call; those at their defaults are left out."""
        arguments = ["ablate", str(self.capture)]
        for name, field in type(self).__dataclass_fields__.items():
            value = getattr(self, name)
            if name != "capture" and value != field.default:
                arguments += [f"--{name.replace('_', '-')}", *(value if isinstance(value, tuple) else [str(value)])]
        return arguments
