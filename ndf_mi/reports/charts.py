"""Charts of a report: SVG in the page's colours, with alternative texts that hold the figures."""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

#: Stands for the page's text colour in drawings; it follows the reader's light or dark theme.
INK = "#123456"
LINES = ("#3b82c4", "#d97a2b", "#7a9a3a", "#b0559e", "#c9a227", "#4aa3a2")
#: Font size in points, widths and heights in inches: legible where a chart shrinks to the width of a phone.
_FONT = 9
_SMALL, _LARGE = (4.6, 2.8), (5.0, 3.8)


@dataclass(frozen=True)
class Key:
    """An entry of a legend: the shape is `solid`, `dotted`, `dashed` (lines) or `ring`, the colour is CSS."""

    label: str
    colour: str
    shape: str


@dataclass(frozen=True)
class Chart:
    """A drawing.

    Attributes:
        title: printed above the chart; may be empty.
        alt: what is seen, with its figures, for those who cannot see it.
        svg: an `<svg>` element without a size of its own.
        legend: what the lines and points are; printed below the title.
    """

    title: str
    alt: str
    svg: str
    legend: tuple[Key, ...] = ()


Series = tuple[str, Sequence[float], Sequence[float]]


def line_chart(
    series: Sequence[Series], x_label: str, y_label: str, title: str, reference: Series | None = None,
    log_x: bool = False, rings: Sequence[tuple[str, int, float, float]] = (),
) -> Chart:
    """A small line chart.

    Args:
        series: (label, x, y) of each line; NaN leaves a gap.
        x_label, y_label: names of the axes.
        title: printed above the chart.
        reference: (label, x, y) of a dashed line in the text's colour.
        log_x: whether x is drawn on a logarithmic axis; all x are positive then.
        rings: (label, index of a line, x, y) of points that are ringed in the line's colour.
    """
    lines = [*series, *([reference] if reference is not None else [])]
    figure, axes = _axes(x_label, y_label)
    keys = []
    for index, (label, x, y) in enumerate(lines):
        colour, shape = LINES[index % len(LINES)], "solid" if index < len(LINES) else "dotted"
        if index == len(series):
            colour, shape = INK, "dashed"
        # A line of a point or two would hardly show.
        marker = "o" if len(x) < 3 else None
        axes.plot(x, y, color=colour, linestyle=shape, linewidth=1.6, marker=marker, markersize=5)
        keys.append(Key(label, colour, shape))
    for label, index, ring_x, ring_y in rings:
        colour = LINES[index % len(LINES)]
        axes.plot(ring_x, ring_y, "o", color=colour, markerfacecolor="none", markersize=11,
                  markeredgewidth=1.6)
        keys.append(Key(label, colour, "ring"))
    values = [value for _, x, _ in lines for value in x]
    if log_x:
        axes.set_xscale("log")
        _ticks(axes.xaxis, max(values) / min(values))
    else:
        whole = all(value == round(value) for value in values)
        axes.xaxis.set_major_locator(MaxNLocator("auto", integer=whole, min_n_ticks=1))
    marked = [f"{label}: {y:.4g} at {x:.4g}." for label, _, x, y in rings]
    alt = f"Line chart of {y_label} against {x_label}. " + " ".join([*map(_describe, lines), *marked])
    return _chart(figure, title, alt, keys if len(keys) > 1 else [])


def front_chart(
    points: Sequence[tuple[str, float, float]], front: Sequence[int], knee: int | None, x_label: str,
    y_label: str, title: str, reference: tuple[str, float] | None = None,
) -> Chart:
    """Cost and quality of points: those on the Pareto front are joined and named, its knee is ringed.

    Args:
        points: (label, cost, quality), finite; cost is drawn on a logarithmic axis.
        front: indices of the points that no other one dominates, by rising cost.
        knee: index of one of them.
        x_label, y_label: names of the axes.
        title: printed above the chart.
        reference: (label, quality) of a dashed horizontal line.
    """
    figure, axes = _axes(x_label, y_label, size=_LARGE)
    axes.set_xscale("log")
    hollow = {"linestyle": "", "marker": "o", "markerfacecolor": "none"}
    rest = [point[1:] for index, point in enumerate(points) if index not in front]
    axes.plot(*np.reshape(rest, (-1, 2)).T, **hollow, color=INK, alpha=0.55, markersize=4)
    joined = np.transpose([points[i][1:] for i in front])
    axes.plot(*joined, "o-", color=LINES[0], linewidth=1.4, markersize=5)
    keys = [Key("Pareto front", LINES[0], "solid"), Key("dominated", INK, "ring")]
    if knee is not None:
        ring = {"color": LINES[1], "markersize": 12, "markeredgewidth": 1.6}
        axes.plot(points[knee][1], points[knee][2], **hollow, **ring)
        keys.append(Key("knee", LINES[1], "ring"))
    if reference is not None:
        label, level = reference
        axes.axhline(level, color=INK, linestyle="--", linewidth=1.0, alpha=0.6)
        keys.append(Key(label, INK, "dashed"))
    low, high = min(x for _, x, _ in points), max(x for _, x, _ in points)
    reach = max(high / low, 1.2)
    axes.set_xlim(low / reach**0.05, high * reach**0.05)
    axes.margins(y=0.1)
    _name_points(axes, points, front, knee)
    left, right = axes.get_xlim()
    _ticks(axes.xaxis, right / left)
    names = ["{}: {:.3g}, {:.2f}".format(*points[i]) + " (knee)" * (i == knee) for i in front]
    alt = f"Scatter chart of {y_label} against {x_label}: {len(points)} points. On the Pareto front: "
    alt += "; ".join(names) + "." + ("" if reference is None else f" Dashed line: {label}, {level:.2f}.")
    return _chart(figure, title, alt, keys)


def fit_chart(measured: Series, fit: Series, x_label: str, y_label: str, title: str) -> Chart:
    """Measurements and the curve that was fitted to them, on logarithmic axes."""
    figure, axes = _axes(x_label, y_label)
    axes.set_xscale("log")
    axes.set_yscale("log")
    (label, x, y), (formula, *curve) = measured, fit
    axes.plot(x, y, "o", color=LINES[0], markersize=5)
    axes.plot(*curve, color=LINES[1], linewidth=1.3)
    for axis, values in ((axes.xaxis, x), (axes.yaxis, y)):
        _ticks(axis, max(values) / min(values))
    # A curve that hardly rises must not fill the height with its noise.
    if max(y) < 2 * min(y):
        axes.set_ylim(min(y) / 1.5, max(y) * 1.5)
    alt = f"Chart of {y_label} against {x_label}, fitted by {formula}. {label.capitalize()}: "
    alt += "; ".join(f"{cost:.3g} at {value:,g}" for value, cost in zip(x, y, strict=True)) + "."
    return _chart(figure, title, alt, [Key(label, LINES[0], "ring"), Key(formula, LINES[1], "solid")])


def _axes(x_label: str, y_label: str, size: tuple[float, float] = _SMALL) -> tuple[Figure, Any]:
    figure = Figure(figsize=size)
    FigureCanvasSVG(figure)
    axes = figure.add_subplot()
    axes.set_xlabel(x_label, color=INK, fontsize=_FONT)
    axes.set_ylabel(y_label, color=INK, fontsize=_FONT)
    axes.tick_params(colors=INK, labelsize=_FONT)
    axes.grid(color=INK, alpha=0.15, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(INK)
    return figure, axes


def _chart(figure: Figure, title: str, alt: str, keys: Sequence[Key]) -> Chart:
    """The drawing as an `<svg>` element that scales; what is drawn in `INK` has the page's text colour."""
    stream = io.StringIO()
    # Identifiers must differ between the charts of a page, and not from run to run.
    salt = hashlib.sha256(f"{title}{alt}".encode()).hexdigest()
    with matplotlib.rc_context({"svg.fonttype": "none", "font.family": "sans-serif", "svg.hashsalt": salt}):
        figure.tight_layout()
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :].replace(INK, "currentColor")
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Only clip paths and markers are referred to; the names of groups are the same in every chart.
    text = re.sub(r' id="[A-Za-z0-9.]+_\d+"', "", text)
    opening, rest = text.split(">", 1)
    svg = re.sub(r' (width|height)="[^"]*"', "", opening) + ">" + rest
    legend = (replace(key, colour=key.colour.replace(INK, "currentColor")) for key in keys)
    return Chart(title, alt, svg, tuple(legend))


def _name_points(
    axes: Any, points: Sequence[tuple[str, float, float]], front: Sequence[int], knee: int | None
) -> None:
    """Writes the names of the front's points, except where one would overlap the name below it.

    Names stand left of their points, where a front has no other point above and before; the axis makes room.
    """
    named: list[int] = []
    height = max(y for _, _, y in points) - min(y for _, _, y in points)
    left, right = np.log(axes.get_xlim())
    for index in front:
        label, x, y = points[index]
        if named and index not in (knee, front[-1]) and y - points[named[-1]][2] < 0.06 * height:
            continue
        named.append(index)
        style = {"fontsize": _FONT, "color": INK, "horizontalalignment": "right"}
        axes.annotate(label, (x, y), xytext=(-5, 5), textcoords="offset points", **style)
        # A letter is about a sixtieth of the axis wide; long names may reach over the axis.
        width = min((len(label) + 2) / 60, 0.5)
        left = min(left, (np.log(x) - width * right) / (1 - width))
    axes.set_xlim(np.exp(left), np.exp(right))


def _ticks(axis: Any, reach: float) -> None:
    """Plain numbers, more of them in each decade where there are few decades."""
    axis.set_major_locator(LogLocator(subs=(1,) if reach > 30 else (1, 2, 3, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def _describe(series: Series) -> str:
    label, x, y = series
    finite = [(a, b) for a, b in zip(x, y, strict=True) if math.isfinite(b)]
    if not finite:
        return f"{label}: no finite value."
    if len(finite) == 1:
        return f"{label}: {finite[0][1]:.4g} at {finite[0][0]:.4g}."
    (start, first), (end, last), values = finite[0], finite[-1], [b for _, b in finite]
    span = f"from {first:.4g} at {start:.4g} to {last:.4g} at {end:.4g}"
    return f"{label}: {span}, lowest {min(values):.4g}, highest {max(values):.4g}."
