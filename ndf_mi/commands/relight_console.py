"""What ``ndf-mi relight`` shows in the terminal at its end."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from ndf_mi.compare import metrics, tables
from ndf_mi.compare.evaluate import LABELS
from ndf_mi.compare.relight_report import KEYS, columns, notes
from ndf_mi.compare.results import Results


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
