"""The report of a growth benchmark: how time and memory rise with the size of the work."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ndf_mi.reports import page
from ndf_mi.reports.charts import Chart
from ndf_mi.reports.page import Fact


@dataclass(frozen=True)
class Curve:
    """What is printed of one curve: its name, its charts, and sentences on how it grows."""

    name: str
    charts: list[Chart]
    sentences: list[str]


def write_growth_report(
    path: str | os.PathLike[str], curves: Sequence[Curve], repeats: int, memory: str, machine: Mapping[str, str]
) -> None:
    """Writes the report as one HTML file.

    Args:
        path: the HTML file.
        curves: the curves, in order.
        repeats: how often each point was timed.
        memory: what is counted as memory; ends a sentence that starts with “Memory is”.
        machine: label and value of each property of the machine.
    """
    origin = [Fact(label, (value,)) for label, value in machine.items()]
    page.write_page(path, "growth.html.j2", curves=curves, repeats=repeats, memory=memory, origin=origin)
