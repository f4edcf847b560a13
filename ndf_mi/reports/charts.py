"""Charts of a trade and of growth, as SVG for the pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, NullLocator

from ndf_mi.experiments.trade.growth import Growth
from ndf_mi.reports import pictures
from ndf_mi.reports.pictures import INK, LINES


def front_chart(
    points: Sequence[tuple[str, float, float]],
    front: Sequence[int],
    knee: int | None,
    x_label: str,
    y_label: str,
    title: str,
    reference: tuple[str, float] | None = None,
) -> str:
    """A trade as an `<svg>` element in the page's text colour: every point, those of the front joined and named, its knee ringed.

    Args:
        points: (label, cost, quality), finite; cost is drawn by its logarithm.
        front: indices of the points that no other beats, by rising cost.
        knee: index of one of them.
        x_label, y_label: of the axes.
        title: above the chart.
        reference: (label, quality) of a dashed line across.
    """
    figure, axes = pictures.chart(x_label, y_label, title, size=(7.4, 4.6))
    axes.set_xscale("log")
    rest = [point for index, point in enumerate(points) if index not in front]
    axes.plot([x for _, x, _ in rest], [y for _, _, y in rest], "o", color=INK, markerfacecolor="none", alpha=0.55, markersize=4,
              label="beaten by another")
    axes.plot([points[i][1] for i in front], [points[i][2] for i in front], "o-", color=LINES[0], linewidth=1.4, markersize=5,
              label="front")
    if knee is not None:
        axes.plot(points[knee][1], points[knee][2], "o", color=LINES[1], markerfacecolor="none", markersize=12, markeredgewidth=1.6,
                  label="knee")
    named: list[int] = []
    height = max(y for _, _, y in points) - min(y for _, _, y in points)
    for index in front:
        label, x, y = points[index]
        # Names of points close above the last one named would stand over one another.
        if named and index not in (knee, front[-1]) and y - points[named[-1]][2] < 0.04 * height:
            continue
        named.append(index)
        axes.annotate(label, (x, y), xytext=(-5, 5), textcoords="offset points", fontsize=8, color=INK, horizontalalignment="right")
    if reference is not None:
        axes.axhline(reference[1], color=INK, linestyle="--", linewidth=1.0, alpha=0.6, label=reference[0])
    # Room for the names, which stand left of their points, where no point of a front has another one above and before it.
    low, high = min(x for _, x, _ in points), max(x for _, x, _ in points)
    reach = max(high / low, 1.2)
    axes.set_xlim(low / reach**0.4, high * reach**0.06)
    axes.margins(y=0.1)
    _ticks(axes.xaxis, reach)
    axes.legend(frameon=False, labelcolor=INK, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncols=4)
    return pictures.as_svg(figure)


def growth_chart(growth: Growth, x_label: str, y_label: str, title: str) -> str:
    """What was measured against what was raised, both by their logarithms, with the line fitted, as an `<svg>` element."""
    figure, axes = pictures.chart(x_label, y_label, title)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.plot(growth.x, growth.y, "o", color=LINES[0], markersize=5, label="measured")
    line = np.geomspace(min(growth.x), max(growth.x), 100)
    axes.plot(line, growth.at(line), color=LINES[1], linewidth=1.3, label=growth.formula())
    for axis, values in ((axes.xaxis, growth.x), (axes.yaxis, growth.y)):
        _ticks(axis, max(values) / min(values))
    # A curve that hardly rises is not to fill the height with its noise.
    low, high = min(growth.y), max(growth.y)
    if high < 2 * low:
        axes.set_ylim(low / 1.5, high * 1.5)
    axes.legend(frameon=False, labelcolor=INK, fontsize=8)
    return pictures.as_svg(figure)


def _ticks(axis: Any, reach: float) -> None:
    """Plain numbers, more of them a decade where there are few decades."""
    axis.set_major_locator(LogLocator(subs=(1,) if reach > 30 else (1, 2, 3, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())
