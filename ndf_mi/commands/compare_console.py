"""What ``ndf-mi compare`` shows in the terminal: progress while it works, tables at the end."""

from __future__ import annotations

import math
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS
from ndf_mi.experiments.records import Results
from ndf_mi.reports import tables


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
    """Prints the headline figures of each split, how far the protocol was kept to, and how the meshes were trained, on stdout."""
    console = Console()
    for split in results.splits():
        table = Table(title=LABELS[split].capitalize(), title_justify="left", box=None, pad_edge=False)
        table.add_column("")
        keys = tables.headline(results)
        for key in keys:
            table.add_column(metrics.LABELS[key], justify="right")
        for row in tables.rows(results, split, keys):
            table.add_row(row.label, *(cell.text for cell in row.cells), style="dim" if row.difference else "")
        console.print(table)
    for note in (*tables.protocol_notes(results), *filter(None, map(tables.mesh_note, results.methods))):
        console.print(note, highlight=False)
