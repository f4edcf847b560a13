"""Pictures inside the report: PNG and SVG as text that HTML can hold."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from PIL import Image

COLOUR_MAP = "magma"
#: Stands for the page's text colour in drawings, which follows the reader's light or dark theme.
INK = "#123456"
LINES = ("#3b82c4", "#d97a2b", "#7a9a3a", "#b0559e", "#c9a227", "#4aa3a2")


def data_uri(image: np.ndarray) -> str:
    """A PNG as a data URI; `image` (h, w, 3) is uint8, or float in [0, 1]."""
    pixels = image if image.dtype == np.uint8 else np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def absolute_error(truth: np.ndarray, image: np.ndarray) -> np.ndarray:
    """(h, w) float: |truth − image| in sRGB, averaged over the channels."""
    return np.abs(truth.astype(np.float64) - image).mean(axis=-1)


def error_scale(errors: Sequence[np.ndarray]) -> float:
    """A round upper end for a colour scale shared by all error maps: covers 99 % of the pixels that have an error."""
    values = np.concatenate([error.ravel() for error in errors]) if errors else np.zeros(1)
    values = values[values > 1 / 255]
    top = float(np.quantile(values, 0.99)) if values.size else 0.0
    return next((end for end in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.75) if top <= end), 1.0)


def error_map(error: np.ndarray, top: float) -> np.ndarray:
    """(h, w, 3) uint8: an error in colours, 0 … `top`."""
    return matplotlib.colormaps[COLOUR_MAP](np.clip(error / top, 0, 1), bytes=True)[..., :3]


def gradient() -> str:
    """The colour map as a CSS gradient, low to high."""
    stops = (matplotlib.colors.to_hex(matplotlib.colormaps[COLOUR_MAP](step / 8)) for step in range(9))
    return f"linear-gradient(to right, {', '.join(stops)})"


def line_chart(
    series: Sequence[tuple[str, Sequence[float], Sequence[float]]],
    x_label: str,
    y_label: str,
    title: str,
    reference: tuple[str, Sequence[float], Sequence[float]] | None = None,
) -> str:
    """A small line chart as an `<svg>` element in the page's text colour.

    Args:
        series: (label, x, y) a line; NaN leaves a gap.
        x_label, y_label: of the axes.
        title: above the chart.
        reference: (label, x, y) of a dashed line in the text's colour.
    """
    figure, axes = chart(x_label, y_label, title)
    for index, (label, x, y) in enumerate(series):
        # A point alone has no line.
        marker = "o" if len(x) < 3 else None
        axes.plot(x, y, label=label, linewidth=1.6, marker=marker, color=LINES[index % len(LINES)])
    if reference is not None:
        label, x, y = reference
        marker = "_" if len(x) < 3 else None
        axes.plot(x, y, label=label, linewidth=1.2, linestyle="--", marker=marker, color=INK, alpha=0.6)
    if len(series) > 1 or reference is not None:
        axes.legend(frameon=False, labelcolor=INK, fontsize=9)
    return as_svg(figure)


def chart(x_label: str, y_label: str, title: str, size: tuple[float, float] = (4.6, 2.9)) -> tuple[Figure, Any]:
    """An empty chart and its axes."""
    figure = Figure(figsize=size)
    FigureCanvasSVG(figure)
    axes = figure.add_subplot()
    axes.set_xlabel(x_label, color=INK)
    axes.set_ylabel(y_label, color=INK)
    axes.set_title(title, color=INK, fontsize=10, loc="left")
    axes.tick_params(colors=INK, labelsize=9)
    axes.grid(color=INK, alpha=0.15, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(INK)
    return figure, axes


def as_svg(figure: Figure) -> str:
    """The figure as an `<svg>` element; what is drawn in `INK` has the page's text colour."""
    figure.tight_layout()
    stream = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "ndf-mi", "svg.fonttype": "none", "font.family": "sans-serif"}):
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue()
    return text[text.index("<svg") :].replace(INK, "currentColor")
