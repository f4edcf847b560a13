"""What ``ndf-mi relight`` shows in the terminal at its end."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS
from ndf_mi.experiments.records import Results
from ndf_mi.reports import tables
from ndf_mi.reports.relight import KEYS, columns, notes


def print_relighting(results: Mapping[str, Results]) -> None:
    """Prints a table a light and split, the noise, and how the mesh was trained, on stdout."""
    console = Console()
    for lighting, split in columns(results):
        table = Table(title=f"{lighting.capitalize()} light, {LABELS[split]}", title_justify="left", box=None, pad_edge=False)
        table.add_column("")
        for key in KEYS:
            table.add_column(metrics.LABELS[key], justify="right")
        for row in tables.rows(results[lighting], split, KEYS):
            table.add_row(row.label, *(cell.text for cell in row.cells), style="dim" if row.difference else "")
        console.print(table)
    for note in notes(results):
        console.print(note, highlight=False)
