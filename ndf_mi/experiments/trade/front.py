"""Which points of a trade are worth taking: the Pareto front and its knee."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def pareto_front(cost: Sequence[float], quality: Sequence[float], least: float = 0.0) -> list[int]:
    """Indices of the points that no other one beats, by rising cost.

    A point is beaten (dominated) by one that costs no more and is no worse, and is better in one of the two; of equal points the
    first stays.

    Args:
        cost: N, lower is better.
        quality: N, higher is better; may be infinite.
        least: by how much a point that costs more must be better to count as better at all.
    """
    order = sorted(range(len(cost)), key=lambda i: (cost[i], -quality[i], i))
    front: list[int] = []
    for index in order:
        if not front or quality[index] > quality[front[-1]] + least:
            front.append(index)
    return front


def knee(cost: Sequence[float], quality: Sequence[float]) -> int | None:
    """Position on a front, by rising cost, beyond which more cost buys ever less: the point farthest above the straight line from the
    front's first point to its last, cost by its logarithm, both axes from 0 to 1 (Satopää et al. 2011, "Finding a kneedle in a haystack").

    None where no point lies above that line, or there are fewer than three.
    """
    if len(cost) < 3:
        return None
    x, y = np.log(np.asarray(cost, dtype=np.float64)), np.asarray(quality, dtype=np.float64)
    # An infinite quality is of no use as a scale: the best finite one stands for it.
    y = np.minimum(y, y[np.isfinite(y)].max(initial=0.0))
    if not (x[-1] > x[0] and y[-1] > y[0]):
        return None
    above = (y - y[0]) / (y[-1] - y[0]) - (x - x[0]) / (x[-1] - x[0])
    best = int(np.argmax(above))
    return best if above[best] > 1e-9 else None
