"""``ndf-mi tradeoff``: what speed costs in accuracy, measured on a run."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ndf_mi.experiments.trade.points import AXES, PATHS, RENDERING, TRAINED

_ONLY_HELP = (f"What to turn: {', '.join(RENDERING)}, which only draw the run otherwise; {PATHS[0]}, which draws it by Mitsuba's volpath; "
              f"{', '.join(TRAINED)}, for which fields are trained. All by default.")


@dataclass
class Tradeoff:
    """Draw a run in every way that trades speed for accuracy, train fields that are wider, narrower or of another kind, and measure all:
    seconds a frame, memory, error against the truth on held-out images and against the same field drawn to convergence. Writes
    tradeoff.csv and report.html with the Pareto fronts and pictures at their knees.

    Stop it when you like: the same command goes on where it was, in the middle of a training too. Timings want a machine with nothing
    else to do.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """The run's folder."""

    capture: Path
    """The capture it was trained on."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the figures, the report, the pictures and the fields trained."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AXIS ...", help=_ONLY_HELP)] = AXES

    steps: int | None = None
    """Steps of each training, in place of a time."""

    seconds: float = 300.0
    """Time for each training, in seconds."""

    views: int = 4
    """Images of each held-out split that errors are measured on."""

    timed: int = 2
    """Images that are timed, of those."""

    repeats: int = 5
    """Times that every point is timed in each of them."""

    path_size: int = 48
    """Longer side in pixels of path traced pictures."""

    seed: int = 0
    """Of the choice of images and of the order of timing."""

    def run(self) -> None:
        """Trains, draws and times what is missing, prints the table and says where the report is."""
        from ndf_mi.experiments.trade.study import REPORT, Settings, TradeStudy
        from ndf_mi.reports.compare import command_line
        from ndf_mi.reports.tradeoff import markdown

        settings = Settings(self.only, self.steps, self.seconds, self.views, self.timed, self.repeats, self.path_size, self.seed)
        study = TradeStudy(self.run_folder, self.capture, self.out, settings, command_line(self._arguments()))
        trade = study.run(lambda text, number, of: print(f"{number} of {of}: {text}", file=sys.stderr, flush=True))
        print(markdown(trade), end="")
        print(f"\n{self.out / REPORT}")

    def _arguments(self) -> list[str]:
        """The options that repeat this call; those at their defaults are left out."""
        arguments = ["tradeoff", str(self.run_folder)]
        for name, field in type(self).__dataclass_fields__.items():
            value = getattr(self, name)
            if name != "run_folder" and value != field.default:
                arguments += [f"--{name.replace('_', '-')}", *(value if isinstance(value, tuple) else [str(value)])]
        return arguments
