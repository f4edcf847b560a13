"""What ``ndf-mi compare`` shows in the terminal: progress while it works, tables at the end."""

from __future__ import annotations

import math
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from ndf_mi.experiments.records import Results
from ndf_mi.reports import training
from ndf_mi.reports.compare import headline
from ndf_mi.reports.page import protocol_notes


class ConsoleWatcher:
    """Shows each mesh's training and each method's rendering as one line; use as a context manager."""

    def __init__(self, stream: TextIO) -> None:
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[facts]}"),
            TimeElapsedColumn(),
            console=Console(file=stream),
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> ConsoleWatcher:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def training(self, label: str, seconds: float, budget: float | None, step: int, loss: float) -> None:
        """Updates the line of a mesh's training."""
        psnr = -10 * math.log10(max(loss, 1e-12))
        facts = f"step {step}  {psnr:.2f} dB"
        self._progress.update(self._task(f"train {label}", budget), completed=seconds, facts=facts)

    def measured(self, label: str, done: int, of: int) -> None:
        """Updates the line of a method's images."""
        self._progress.update(self._task(f"render {label}", of), completed=done, facts=f"{done} of {of} images")

    def _task(self, label: str, total: float | None) -> TaskID:
        if label not in self._tasks:
            self._tasks[label] = self._progress.add_task(label, total=total, facts="")
        return self._tasks[label]


def print_tables(results: Results) -> None:
    """Prints the headline figures of each split, differences to the protocol, and how methods were trained, on stdout."""
    console = Console()
    for part in headline(results, results.splits()).parts():
        console.print(part.terminal())
    for note in (*protocol_notes(results.about), *training.notes(results)):
        console.print(note, highlight=False)
