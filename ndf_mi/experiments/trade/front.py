"""The points of a trade that are worth choosing: the Pareto front and its knee."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def pareto_front(cost: Sequence[float], quality: Sequence[float], least: float = 0.0) -> list[int]:
    """Indices of the points that no other point dominates, by rising cost.

    A point dominates another if it costs no more, is no worse, and is better in one of the two. Of equal
    points the first stays.

    Args:
        cost: N, lower is better.
        quality: N, higher is better; may be infinite.
        least: the difference in quality above which a more expensive point counts as better.
    """
    order = sorted(range(len(cost)), key=lambda i: (cost[i], -quality[i], i))
    front: list[int] = []
    for index in order:
        if not front or quality[index] > quality[front[-1]] + least:
            front.append(index)
    return front


def knee(cost: Sequence[float], quality: Sequence[float]) -> int | None:
    """The position on a front beyond which more cost buys less and less.

    It is the point farthest above the straight line from the front's first to its last point, with the
    logarithm of the cost and both axes scaled to [0, 1] (Satopää et al. 2011, "Finding a kneedle in a
    haystack"). None if no point lies above that line, or there are fewer than three.
    """
    if len(cost) < 3:
        return None
    x, y = np.log(np.asarray(cost, dtype=np.float64)), np.asarray(quality, dtype=np.float64)
    # An infinite quality has no place on a scale: the best finite one stands in for it.
    y = np.minimum(y, y[np.isfinite(y)].max(initial=0.0))
    if not (x[-1] > x[0] and y[-1] > y[0]):
        return None
    above = (y - y[0]) / (y[-1] - y[0]) - (x - x[0]) / (x[-1] - x[0])
    best = int(np.argmax(above))
    return best if above[best] > 1e-9 else None
