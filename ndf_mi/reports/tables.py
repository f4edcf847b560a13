"""The comparison's figures as rows of text, for the terminal and for the report alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ndf_mi.experiments import metrics
from ndf_mi.experiments.protocols import OURS
from ndf_mi.experiments.records import MethodResult, Results

HEADLINE = OURS.headline
DECIMALS = {"box_psnr": 2, "box_tpsnr": 2, "psnr": 2}


@dataclass(frozen=True)
class Cell:
    """A figure as text, and whether it is the best of its column."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Row:
    """A method, or the difference of the first method to another."""

    label: str
    cells: tuple[Cell, ...]
    difference: bool = False


def headline(results: Results) -> tuple[str, ...]:
    """The keys of the figures that lead under the protocol that was measured by."""
    return tuple(results.about.get("protocol", {}).get("headline", HEADLINE))


def protocol_sentence(results: Results) -> str:
    """The protocol that was measured by, and what it says."""
    protocol = results.about["protocol"]
    return f"Protocol {protocol['name']}: {protocol['description']}"


def protocol_notes(results: Results) -> list[str]:
    """Sentences on where training, images or their number differ from the protocol's."""
    return list(results.about.get("protocol", {}).get("notes", []))


def rows(results: Results, split: str, keys: tuple[str, ...]) -> list[Row]:
    """A row a method with the means over a split, and below it how far the first method is from each other one."""
    methods = results.methods
    columns = [[method.mean(split, key) for method in methods] for key in keys]
    table = [
        Row(method.label, tuple(_cell(key, column, index) for key, column in zip(keys, columns, strict=True)))
        for index, method in enumerate(methods)
    ]
    for index, method in enumerate(methods[1:], start=1):
        cells = (Cell(signed(key, difference(col[0], col[index]))) for key, col in zip(keys, columns, strict=True))
        table.append(Row(f"{methods[0].label} − {method.label}", tuple(cells), difference=True))
    return table


def difference(first: float | None, second: float | None) -> float | None:
    """first − second; None where one is not defined, or both are infinite."""
    if first is None or second is None or (math.isinf(first) and math.isinf(second)):
        return None
    return first - second


def figure(key: str, value: float | None) -> str:
    """A figure with the decimals of its metric; “∞” for infinity, “–” where it is not defined."""
    if value is None:
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:.{DECIMALS.get(key, 4)}f}"


def signed(key: str, value: float | None) -> str:
    """A difference with its sign, in typographic minus."""
    text = figure(key, None if value is None else abs(value))
    return text if value is None else ("+" if value >= 0 else "−") + text


def duration(seconds: float | None) -> str:
    """Seconds as people read them: 0.42 s, 38 s, 6 min 05 s, 2 h 10 min."""
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


def mesh_note(method: MethodResult) -> str:
    """How a mesh's training went, in one sentence; empty for other methods."""
    facts = method.metadata
    if "budget" not in facts:
        return ""
    how = f"trained for {duration(facts['seconds'])}"
    if facts["budget"] is None:
        end = "until its loss stopped falling" if facts["converged"] else "until the limit of steps"
        how = f"{how}, {end}"
    text = f"{method.label}: {how}, {facts['steps']} steps, learning rate {facts['rate']:g}"
    if "offset_rate" in facts:
        text += (f", offsets' first step {facts['offset_rate']:g} m; offsets of {facts['offset_median_mm']:.0f} mm in the median, "
                 f"{facts['offset_max_mm']:.0f} mm at most")
    return text + "."


def lower(label: str) -> str:
    """A label inside a sentence: “Mesh, equal time” → “mesh, equal time”; abbreviations stay."""
    return label if label[:2].isupper() else label[:1].lower() + label[1:]


def _cell(key: str, column: list[float | None], index: int) -> Cell:
    defined = [value for value in column if value is not None]
    best = (max if metrics.HIGHER_IS_BETTER[key] else min)(defined, default=None)
    value = column[index]
    return Cell(figure(key, value), best=value is not None and value == best and len(defined) > 1)
