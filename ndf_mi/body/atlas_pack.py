"""Places charts in the unit square, at one scale and without flipping them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

MARGIN = 1 / 256
"""Free space around each chart, as a fraction of the square's side."""


def pack(charts: list[np.ndarray]) -> np.ndarray:
    """The vertices of all charts, (ΣU, 2) in [0, 1]: rotated, and placed in rows by height.

    Charts are rotated so that the square, or else the rectangle, around each is smallest, whichever packs
    better.

    Args:
        charts: (U, 2) each, at one scale.
    """
    best: tuple[float, list[np.ndarray], np.ndarray] | None = None
    for measure in (np.max, np.prod):
        turned = [_turned(chart, measure) for chart in charts]
        sizes = np.array([chart.max(0) for chart in turned])
        order = np.argsort(-sizes[:, 1], kind="stable")
        gap = MARGIN * _spread(sizes, order, 0.0)[1]
        places, side = _spread(sizes, order, gap)
        if best is None or side < best[0]:
            best = side, turned, places
    assert best is not None
    side, turned, places = best
    placed = [chart + place for chart, place in zip(turned, places, strict=True)]
    return (np.concatenate(placed) / side).clip(0, 1)


def _turned(flat: np.ndarray, measure: Callable[[np.ndarray], float]) -> np.ndarray:
    """Rotates a chart, (U, 2), by the degree with the least measure of its sides; from 0, upright."""
    angles = np.deg2rad(np.arange(90.0))
    cosine, sine = np.cos(angles), np.sin(angles)
    turns = np.stack([cosine, -sine, sine, cosine], axis=1).reshape(-1, 2, 2)
    turned = flat @ min(turns, key=lambda turn: measure(np.ptp(flat @ turn.T, axis=0))).T
    if np.ptp(turned[:, 0]) > np.ptp(turned[:, 1]):
        turned = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    return turned - turned.min(0)


def _spread(sizes: np.ndarray, order: np.ndarray, gap: float) -> tuple[np.ndarray, float]:
    """Positions of boxes, (N, 2), with free space around each, and the side of the smallest square."""
    widest = float(sizes[:, 0].max())
    widths = np.unique(np.r_[widest, np.geomspace(widest, max(float(sizes[:, 0].sum()), widest), 24)])
    tried = [_rows(sizes, order, gap, float(width) * (1 + 1e-9) + (len(sizes) + 1) * gap) for width in widths]
    return min(tried, key=lambda found: found[1])


def _rows(sizes: np.ndarray, order: np.ndarray, gap: float, width: float) -> tuple[np.ndarray, float]:
    places = np.zeros_like(sizes)
    x, y, height, right = gap, gap, 0.0, 0.0
    for i in order.tolist():
        if x > gap and x + sizes[i, 0] + gap > width:
            x, y, height = gap, y + height + gap, 0.0
        places[i] = x, y
        x += sizes[i, 0] + gap
        height = max(height, sizes[i, 1])
        right = max(right, x)
    return places, max(right, y + height + gap)
