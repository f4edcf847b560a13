"""Tables: one value that the terminal, Markdown and HTML all render, and how figures are written."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import rich.console
import rich.table

from ndf_mi.experiments import metrics
from ndf_mi.experiments.records import Results

#: Decimals of a metric where they are not four.
DECIMALS = {"box_psnr": 2, metrics.MATCHED: 2, "box_tpsnr": 2, "psnr": 2}


@dataclass(frozen=True)
class Cell:
    """Text, and whether it is the best of its column."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Row:
    """A line of a table: its heading and its cells; `difference` marks the difference of two other lines."""

    label: str
    cells: tuple[Cell, ...]
    difference: bool = False


@dataclass(frozen=True)
class Table:
    """A table whose lines have headings.

    Attributes:
        columns: headings of the columns, without that of the line headings.
        rows: the lines, with as many cells as there are columns.
        groups: (heading, number of columns) of groups that cover all columns in order; empty for no groups. A
            heading may be empty.
        caption: what the table shows.
        corner: heading of the line headings.
    """

    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    groups: tuple[tuple[str, int], ...] = ()
    caption: str = ""
    corner: str = ""

    def parts(self) -> Iterator[Table]:
        """A table for each group, with the group's heading as its caption: narrow enough for a terminal."""
        ends = list(itertools.accumulate(span for _, span in self.groups))
        for (heading, span), end in zip(self.groups, ends, strict=True):
            part = slice(end - span, end)
            rows = tuple(replace(row, cells=row.cells[part]) for row in self.rows)
            yield Table(self.columns[part], rows, caption=heading, corner=self.corner)

    def markdown(self) -> str:
        """The table in Markdown; columns of a group carry its heading."""
        groups = [f"{heading}: " if heading else "" for heading, span in self.groups for _ in range(span)]
        columns = [a + b for a, b in itertools.zip_longest(groups, self.columns, fillvalue="")]
        lines = [[self.corner, *columns], ["---"] * (len(columns) + 1)]
        lines += [[row.label, *(cell.text for cell in row.cells)] for row in self.rows]
        escaped = ([text.replace("|", r"\|") for text in line] for line in lines)
        return "".join(f"| {' | '.join(line)} |\n" for line in escaped)

    def terminal(self) -> rich.table.Table:
        """The table for a terminal, without its groups (see `parts`)."""
        table = rich.table.Table(title=self.caption, title_justify="left", box=None, pad_edge=False)
        table.add_column(self.corner)
        for column in self.columns:
            table.add_column(column, justify="right")
        for row in self.rows:
            style = "dim" if row.difference else ""
            table.add_row(row.label, *(cell.text for cell in row.cells), style=style)
        return table


def comparison(groups: Sequence[tuple[str, Results, str]], keys: Sequence[str], caption: str = "") -> Table:
    """The means of every method, with their standard deviation over seeds where it was trained with several,
    and the difference of the first method to each other one.

    Args:
        groups: (heading, results, split) of each group of columns; all results hold the same methods.
        keys: the metrics of each group, by their keys in `metrics.LABELS`.
        caption: what the table shows.
    """
    labels = [method.label for method in groups[0][1].trainings()]
    columns = [
        (key, [method.mean(split, key) for method in methods],
         [method.spread(split, key) for method in methods])
        for _, methods, split in ((heading, results.trainings(), split) for heading, results, split in groups)
        for key in keys
    ]
    rows = [
        Row(label, tuple(_cell(key, means, spreads, index) for key, means, spreads in columns))
        for index, label in enumerate(labels)
    ]
    for index, label in enumerate(labels[1:], start=1):
        cells = (Cell(signed(key, difference(means[0], means[index]))) for key, means, _ in columns)
        rows.append(Row(f"{labels[0]} − {label}", tuple(cells), difference=True))
    headings = tuple((heading, len(keys)) for heading, _, _ in groups if heading)
    names = tuple(metrics.LABELS[key] for key, *_ in columns)
    return Table(names, tuple(rows), headings, caption, corner="Method")


def print_table(table: Table, notes: Sequence[str] = ()) -> None:
    """Prints the groups of a table one below the other, then some sentences, on stdout."""
    console = rich.console.Console()
    for part in table.parts():
        console.print(part.terminal())
    for note in notes:
        console.print(note, highlight=False, markup=False)


def difference(first: float | None, second: float | None) -> float | None:
    """first − second; None where one is undefined, or both are infinite."""
    if first is None or second is None or (math.isinf(first) and math.isinf(second)):
        return None
    return first - second


def figure(key: str, value: float | None) -> str:
    """A figure with the decimals of its metric; “∞” for infinity, “–” where it is undefined."""
    if value is None:
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:.{DECIMALS.get(key, 4)}f}"


def signed(key: str, value: float | None) -> str:
    """A difference with its sign, as a typographic minus where it is negative."""
    text = figure(key, None if value is None else abs(value))
    return text if value is None else ("+" if value >= 0 else "−") + text


def duration(seconds: float | None) -> str:
    """Seconds as people read them: 0.42 s, 38 s, 6 min 05 s, 2 h 10 min; “–” for None."""
    if seconds is None:
        return "–"
    if seconds < 10:
        return f"{seconds:.2f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def size(count: int | None) -> str:
    """Bytes as people read them: 830 kB, 12 MB, 1.4 GB; “–” for None."""
    if count is None:
        return "–"
    for factor, unit in ((1e9, "GB"), (1e6, "MB")):
        if count >= factor:
            return f"{count / factor:.1f} {unit}" if count < 10 * factor else f"{count / factor:.0f} {unit}"
    return f"{count / 1e3:.0f} kB"


def count(number: int, noun: str) -> str:
    """“1 image”, “12 images”, “1,200 images”."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def named(label: str) -> str:
    """A label that can stand in a sentence or list: “Mesh, equal time” → “Mesh (equal time)”."""
    name, comma, more = label.partition(", ")
    return f"{name} ({more})" if comma else name


def _cell(key: str, column: Sequence[float | None], spreads: Sequence[float | None], index: int) -> Cell:
    defined = [value for value in column if value is not None]
    best = (max if metrics.HIGHER_IS_BETTER[key] else min)(defined, default=None)
    value, spread = column[index], spreads[index]
    text = figure(key, value) + ("" if spread is None else f" ± {figure(key, spread)}")
    return Cell(text, best=value is not None and value == best and len(defined) > 1)
