"""``ndf-mi tradeoff``: the trade of speed for accuracy, measured on a run."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ndf_mi.commands.command_line import command_line
from ndf_mi.experiments.trade.points import AXES, PATHS, RENDERING, TRAINED

REPORT = "report.html"
_ONLY_HELP = (
    f"What is varied: {', '.join(RENDERING)}, which render the run with other settings; {PATHS[0]}, which "
    f"renders it with Mitsuba's volpath; {', '.join(TRAINED)}, which train fields. All by default."
)


@dataclass
class Tradeoff:
    """Measure the trade of speed for accuracy on a run: seconds a frame, memory, error against the truth on
    held-out images and against the same field rendered to convergence. The run is rendered with many
    settings, and fields of other sizes and kinds are trained. Writes tradeoff.csv and report.html with the
    Pareto fronts and pictures at their knees.

    You can stop it at any time: the same command continues where it stopped, even within a training. Run it
    on a machine with nothing else to do, because it measures times.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """The run's folder."""

    capture: Path
    """The capture that it was trained on."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the figures, the report, the pictures and the trained fields."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="AXIS ...", help=_ONLY_HELP)] = AXES

    steps: int | None = None
    """Steps of each training, instead of a time."""

    seconds: float = 300.0
    """Time of each training in seconds."""

    views: int = 4
    """Images of each held-out split that errors are measured on."""

    timed: int = 2
    """How many of these images are timed."""

    repeats: int = 5
    """How often every point is timed in each of them."""

    path_size: int = 48
    """Longer side of path-traced pictures in pixels."""

    seed: int = 0
    """Seed of the choice of images and of the order of timing."""

    def run(self) -> None:
        """Trains, renders and times what is missing, writes the report, prints the table and the report's
        path.
        """
        from ndf_mi.commands.progress import ConsoleProgress
        from ndf_mi.experiments.trade.study import Settings, TradeStudy
        from ndf_mi.reports.tradeoff import markdown, write_trade_report

        settings = Settings(
            self.only, self.steps, self.seconds, self.views, self.timed, self.repeats, self.path_size,
            self.seed,
        )
        study = TradeStudy(self.run_folder, self.capture, self.out, settings, command_line("tradeoff", self))
        with ConsoleProgress(sys.stderr, bars=False) as progress:
            trade = study.run(progress)
        write_trade_report(self.out / REPORT, trade, study.capture, self.out)
        print(markdown(trade), end="")
        print(f"\n{self.out / REPORT}")
