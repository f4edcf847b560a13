"""What ``ndf-mi relight`` shows in the terminal at its end."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console

from ndf_mi.experiments.records import Results
from ndf_mi.reports.relight import notes, table


def print_relighting(results: Mapping[str, Results]) -> None:
    """Prints a table for each light and split, the noise, and how the mesh was trained, on stdout."""
    console = Console()
    for part in table(results).parts():
        console.print(part.terminal())
    for note in notes(results):
        console.print(note, highlight=False)
