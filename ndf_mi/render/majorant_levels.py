"""Chooses the densities at which nested shells are cut, so that free flights meet few null collisions."""

from __future__ import annotations

import numpy as np

from ndf_mi.render.majorant import Bounds
from ndf_mi.render.shell import spread

CANDIDATES = 32
"""Number of densities among which levels are chosen, evenly spaced in their logarithm."""

CROSSING = 0.5
"""Cost of crossing a shell, in evaluations of the field."""

CROSSED = 0.4
"""Approximate share of a crossed cell that lies inside the shell."""


def choose_levels(bounds: Bounds, layers: int, crossing: float = CROSSING) -> list[tuple[float, ...]]:
    """For every number of shells, the levels t_1 < t_2 < … that minimise the expected cost of a ray through
    nested shells.

    Shell k > 0 surrounds the cells whose estimate is above t_k. Between shells k and k + 1 the majorant is
    t_(k+1); within the last shell it is the largest estimate. By Cauchy and Crofton, straight lines of all
    directions and positions that meet the body pass through a volume V over a length proportional to 4·V, and
    cross a surface A in proportion to 2·A. The cost of some levels is therefore proportional to

        Σ_k M_k·(V_k − V_(k+1)) + crossing·Σ_k A_k/2

    where each cell counts in proportion to the light from outside that reaches it (`Bounds.seen`). Dynamic
    programming compares all choices among :data:`CANDIDATES` densities, with each shell treated as if it were
    alone. :func:`expected_cost` then decides which number of shells is best.

    Args:
        bounds: estimates of the field's density.
        layers: largest number of shells, the outermost included; at least 1.
        crossing: cost of crossing a shell, in evaluations of the field.

    Returns:
        for 1, 2, … `layers` shells the levels, one fewer than shells; ascending, in 1/m.
    """
    upper = bounds.upper[bounds.band]
    if layers < 2 or not upper.size or upper.max() <= upper.min() * 1.01:
        return [()]
    levels = np.geomspace(upper.min(), upper.max(), CANDIDATES + 1)[:-1]
    seen = bounds.seen
    # How many candidates each cell's estimate exceeds, in the cells themselves and in those that a shell
    # around them crosses.
    own = np.where(bounds.band, np.searchsorted(levels, bounds.upper), 0).astype(np.uint8)
    around = spread(own)

    def above(count: np.ndarray) -> np.ndarray:
        """Number of cells whose `count` is above 0, 1, …, weighted by light."""
        each = np.bincount(count.ravel(), seen.ravel(), minlength=CANDIDATES + 1)
        return np.cumsum(each[::-1])[::-1][1:]

    within, reached = above(own), above(around)
    volume = (within + CROSSED * (reached - within)) * bounds.grid.cell**3
    area = (reached - within) * bounds.grid.cell**2
    everything = float(seen[bounds.band].sum() * bounds.grid.cell**3)
    # The smallest cost outside shell j, the innermost so far, and the levels that give it.
    best: dict[int, tuple[float, tuple[int, ...]]] = {
        j: (levels[j] * (everything - volume[j]) + crossing * area[j] / 2, (j,)) for j in range(1, CANDIDATES)
    }
    chosen: list[tuple[int, ...]] = [()]
    while len(chosen) < layers and best:
        chosen.append(
            min((cost + float(upper.max()) * volume[j], path) for j, (cost, path) in best.items())[1]
        )
        further: dict[int, tuple[float, tuple[int, ...]]] = {}
        for j in range(min(best) + 1, CANDIDATES):
            further[j] = min((cost + levels[j] * (volume[i] - volume[j]) + crossing * area[j] / 2, (*path, j))
                             for i, (cost, path) in best.items() if i < j)
        best = further
    return [tuple(float(levels[j]) for j in path) for path in chosen]


def expected_cost(
    rank: np.ndarray, majorants: list[float], bounds: Bounds, crossing: float = CROSSING
) -> float:
    """The cost that :func:`choose_levels` minimises, for given shells: in square metres, to compare shells of
    the same field.

    Args:
        rank: (nx + 1, ny + 1, nz + 1) number of shells around each node of the grid of `bounds`, which may
            have a border added.
        majorants: of the layers, in 1/m.
        bounds: estimates of the field's density.
        crossing: cost of crossing a shell, in evaluations of the field.
    """
    cell = bounds.grid.cell
    pad = [
        ((n - 1 - m) // 2, (n - 1 - m) // 2 + 1) for n, m in zip(rank.shape, bounds.seen.shape, strict=True)
    ]
    seen = np.pad(bounds.seen, pad, constant_values=1.0)
    flights = cell**3 * float((np.array([0.0, *majorants], np.float32)[rank] * seen).sum())
    crossed = 0.0
    for axis in range(3):
        rows, weight = np.moveaxis(rank, axis, 0), np.moveaxis(seen, axis, 0)
        crossed += float(weight[:-1][rows[:-1] != rows[1:]].sum())
    # Staircases along the axes have 3/2 of the area that they approximate, on average over directions.
    return flights + crossing * cell**2 * crossed / 1.5 / 2
