"""How commands show progress: as a bar, or of experiments as bars on a terminal or lines in a log."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from rich import progress as rich
from rich.console import Console

from ndf_mi.experiments import core
from ndf_mi.experiments.core import Unit
from ndf_mi.experiments.store import NO_RECORD


class ConsoleProgress(core.Progress):
    """A bar for each group of units on a terminal; elsewhere, a line when something new begins. To be used as
    a context manager.

    Args:
        stream: where to write.
        bars: whether to show bars on a terminal; not for experiments whose trainings print progress of their
            own.
    """

    def __init__(self, stream: TextIO, bars: bool = True) -> None:
        self._console = Console(file=stream)
        self._bars = bars and self._console.is_terminal
        self._progress = rich.Progress(
            rich.SpinnerColumn(), "{task.description}", rich.BarColumn(), "{task.fields[details]}",
            rich.TimeElapsedColumn(), console=self._console,
        )
        self._tasks: dict[str, rich.TaskID] = {}
        self._begun: set[str] = set()

    def __enter__(self) -> ConsoleProgress:
        if self._bars:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars:
            self._progress.stop()

    def training(self, label: str, seconds: float, budget: float | None, step: int, loss: float) -> None:
        """Updates the bar of a training."""
        if self._bars:
            details = f"step {step}  {-10 * math.log10(max(loss, 1e-12)):.2f} dB"
            self._progress.update(self._task(label), total=budget, completed=seconds, details=details)

    def begin(self, unit: Unit[Any], number: int, of: int, why: str) -> None:
        """Shows a new bar, or prints a line unless one of this label was printed; with the reason if an
        earlier record is stale.
        """
        if self._bars:
            self._progress.update(self._task(unit.group or unit.label), description=unit.label, total=of)
        elif unit.label not in self._begun:
            self._begun.add(unit.label)
            details = [f"{number} of {of}"] * (of > 1) + [why] * (why != NO_RECORD)
            text = f"{unit.label} ({'; '.join(details)})" if details else unit.label
            self._console.print(text, highlight=False, soft_wrap=True)

    def done(self, unit: Unit[Any], number: int, of: int) -> None:
        """Updates the bar of a group."""
        if self._bars:
            task = self._task(unit.group or unit.label)
            self._progress.update(task, total=of, completed=number, details=f"{number} of {of}")

    def _task(self, name: str) -> rich.TaskID:
        if name not in self._tasks:
            self._tasks[name] = self._progress.add_task(name, total=None, details="")
        return self._tasks[name]


@contextmanager
def image_bar(what: str = "images") -> Iterator[Callable[[int, int], None]]:
    """Yields a function of the numbers of finished and of all images, or of ``what``. The bar starts with its
    first call, so that errors before it come without a bar, and ends when all are finished, so that another
    one can follow."""
    columns = (rich.BarColumn(), rich.MofNCompleteColumn(), rich.TimeElapsedColumn())
    bar = rich.Progress("{task.description}", *columns, rich.TimeRemainingColumn())
    task = bar.add_task(what, total=None)

    def show(done: int, total: int) -> None:
        if not bar.finished:
            bar.start()
        bar.update(task, completed=done, total=total)
        if bar.finished:
            bar.stop()

    try:
        yield show
    finally:
        if not bar.finished:
            bar.stop()
