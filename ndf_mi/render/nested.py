"""Nested shells: closed meshes around ever denser parts of a field, with local majorants."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.model import Model
from ndf_mi.render.majorant import FLOOR, MARGIN, Bounds, bounds, densities, exceeding, random_points
from ndf_mi.render.ray_samples import BoundedField
from ndf_mi.render.shell import Distances, Grid, band_points, corners_of, cut, distances, spread

CHECKED = 1 << 16
"""Random points of the band at which majorants are checked."""

COVERED = 1 << 12
"""Random points of the band that are tested to lie in the shells after the body has moved."""

CANDIDATES = 32
"""Number of densities among which levels are chosen, evenly spaced in their logarithm."""

CROSSING = 0.5
"""Cost of crossing a shell, in evaluations of the field."""

CROSSED = 0.4
"""Approximate share of a crossed cell that lies inside the shell."""


@dataclass(frozen=True)
class Layers:
    """A partition of space into layers 0, 1, …, K − 1 between nested shells: layer k lies within shell k and
    outside shell k + 1.

    Attributes:
        grid: the grid that the shells are cut from.
        rank: (nx + 1, ny + 1, nz + 1) uint8, the number of shells that each node lies within. Neighbours
            differ by at most one.
        levels: t_1 < … < t_(K−1), in 1/m.
        shells: K pairs of vertices (N, 3) float32 and faces (M, 3) uint32, outermost first; closed, normals
            pointing out.
    """

    grid: Grid
    rank: np.ndarray
    levels: tuple[float, ...]
    shells: list[tuple[np.ndarray, np.ndarray]] = field(repr=False)

    def locate(self, points: np.ndarray) -> np.ndarray:
        """(N,) int64 layers of points (N, 3): next to a shell the outer of the two; −1 where a point may be
        outside all shells."""
        lowest, _ = corner_ranks(self.rank)
        return lowest[self.grid.index(points)].astype(np.int64) - 1


def ranks(estimate: Bounds, levels: tuple[float, ...]) -> tuple[Grid, np.ndarray]:
    """How many of the shells at given levels enclose each node.

    Every node that touches a cell with an estimate above t_k is within shell k, and its 26 neighbours are at
    least within shell k − 1. The cells that shell k crosses thus lie entirely inside shell k − 1, which
    crosses others: shells neither meet nor touch.

    Args:
        levels: ascending, in 1/m; none for the outermost shell alone.

    Returns:
        the estimate's grid with a border added, and the ranks of its nodes as in :class:`Layers`.
    """
    pad = len(levels) + 1
    source = estimate.grid
    nx, ny, nz = (n + 2 * pad for n in source.shape)
    cells = np.where(estimate.band, 1 + np.searchsorted(levels, estimate.upper), 0).astype(np.uint8)
    rank = corners_of(np.pad(cells, pad))
    for _ in levels:
        around = spread(rank)
        rank = np.maximum(rank, around - (around > 0))
    return Grid(source.low - pad * source.cell, source.cell, (nx, ny, nz)), rank


def cut_layers(
    estimate: Bounds, sampled: Distances, band: float, inside: float, levels: tuple[float, ...]
) -> Layers:
    """Nested shells at given levels.

    Args:
        sampled: the distances that the estimate was made from.
        band, inside: how far the band reaches outside and inside the body, in metres.
        levels: ascending, in 1/m; none for the outermost shell alone.
    """
    grid, rank = ranks(estimate, levels)
    pad = len(levels) + 1
    outside = np.pad(sampled.at_nodes(band, inside) / grid.cell, pad, constant_values=1.0)
    with np.errstate(divide="ignore"):
        upper = np.log(corners_of(np.pad(estimate.upper, pad)))
    smooth = [outside, *(np.log(level) - upper for level in levels)]
    return Layers(grid, rank, levels, [cut(rank > k, value, grid) for k, value in enumerate(smooth)])


def best_levels(estimate: Bounds, count: int) -> tuple[float, ...]:
    """The levels of at most `count` nested shells with the lowest expected cost."""

    def cost(levels: tuple[float, ...]) -> float:
        grid, rank = ranks(estimate, levels)
        return expected_cost(rank, layer_majorants(grid, rank, estimate), estimate)

    return min(choose_levels(estimate, count), key=cost)


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
        ended = ((cost + float(upper.max()) * volume[j], path) for j, (cost, path) in best.items())
        chosen.append(min(ended)[1])
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
        crossing: cost of crossing a shell, in evaluations of the field.
    """
    cell = bounds.grid.cell
    excess = (n - 1 - m for n, m in zip(rank.shape, bounds.seen.shape, strict=True))
    pad = [(extra // 2, extra // 2 + 1) for extra in excess]
    seen = np.pad(bounds.seen, pad, constant_values=1.0)
    flights = cell**3 * float((np.array([0.0, *majorants], np.float32)[rank] * seen).sum())
    crossed = 0.0
    for axis in range(3):
        rows, weight = np.moveaxis(rank, axis, 0), np.moveaxis(seen, axis, 0)
        crossed += float(weight[:-1][rows[:-1] != rows[1:]].sum())
    # Staircases along the axes have 3/2 of the area that they approximate, on average over directions.
    return flights + crossing * cell**2 * crossed / 1.5 / 2


def layer_majorants(grid: Grid, rank: np.ndarray, estimate: Bounds) -> list[float]:
    """For each layer the largest estimate in 1/m of the cells that it reaches into; at least
    :data:`FLOOR`. The estimates may be on another grid of the same spacing."""
    upper = _on(grid, estimate)
    lowest, highest = corner_ranks(rank)
    return [
        float(np.max(upper, where=(lowest <= k) & (k <= highest), initial=FLOOR))
        for k in range(1, int(rank.max()) + 1)
    ]


def corner_ranks(rank: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest rank among each cell's corners, (nx, ny, nz)."""
    lowest = np.uint8(255) - corners_of(np.uint8(255) - rank)
    return lowest[1:-1, 1:-1, 1:-1], corners_of(rank)[1:-1, 1:-1, 1:-1]


class Majorants:
    """Nested shells around a field at one pose, and majorants between them that can be estimated again as the
    field changes.

    Args:
        posed: the field at its pose, or sampled on a grid.
        vertices: flat (3·V) posed positions in metres.
        count: largest number of shells, at least 1.
        cell: the grid's spacing in metres.
        margin: factor from sampled densities to estimates, above 1.

    Attributes:
        layers: the shells.
        values: the layers' majorants in 1/m.
        excess: densities above the estimated majorants that a check at other points found, if any. The
            majorants were raised.
    """

    def __init__(self, model: Model, posed: BoundedField, vertices: mi.Float, count: int, cell: float,
                 margin: float = MARGIN) -> None:
        self._surface = model.surface
        self._preset = model.field.preset
        self._bands = model.bands
        self._margin = margin
        self._cell = cell
        self._checks = 0
        self._sampled = distances(model.surface, vertices, self._preset.band, cell, self._bands)
        estimate = bounds(posed, self._preset, self._sampled, margin)
        levels = best_levels(estimate, count)
        self.layers = cut_layers(estimate, self._sampled, self._preset.band, self._preset.band_inside, levels)
        self._settle(posed, estimate)

    def left_out(self, vertices: mi.Float) -> float:
        """The share of the band around these vertices that lies outside the shells, from random points; 0 for
        the body that the shells were made around."""
        posed = dr.detach(vertices).numpy().reshape(-1, 3)
        points = band_points(self._surface, posed, self._preset.band, self._preset.band_inside, COVERED,
                             bands=self._bands)
        return float(np.mean(self.layers.locate(points) < 0))

    def update(self, posed: BoundedField, vertices: mi.Float | None = None) -> None:
        """Estimates the majorants again, for a changed field between the same shells; `vertices` are the
        body's, if they have changed."""
        if vertices is not None:
            self._sampled = distances(self._surface, vertices, self._preset.band, self._cell, self._bands)
        self._settle(posed, bounds(posed, self._preset, self._sampled, self._margin))

    def _settle(self, posed: BoundedField, estimate: Bounds) -> None:
        values = np.array(layer_majorants(self.layers.grid, self.layers.rank, estimate))
        points = random_points(estimate.grid, estimate.band, CHECKED, self._checks)
        self._checks += 1
        sigma, layer = densities(posed, points), self.layers.locate(points)
        covered = layer >= 0
        points, sigma, layer = points[covered], sigma[covered], layer[covered]
        self.excess = exceeding(points, sigma, values[layer])
        above = sigma > values[layer]
        np.maximum.at(values, layer[above], np.minimum(self._margin * sigma[above], estimate.limit))
        self.values = [float(value) for value in values]


def _on(grid: Grid, estimate: Bounds) -> np.ndarray:
    """The estimates on another grid of the same spacing: the maximum over overlapping cells."""
    source = estimate.grid
    upper = np.zeros(grid.shape, dtype=np.float32)
    offset = (source.low - grid.low) / grid.cell
    whole = np.round(offset).astype(int)
    aligned = bool(np.all(np.abs(offset - whole) < 1e-3))
    for shift in np.ndindex(*((1, 1, 1) if aligned else (2, 2, 2))):
        start = (whole if aligned else np.floor(offset).astype(int)) + shift
        low, high = np.maximum(start, 0), np.minimum(start + source.shape, grid.shape)
        if (high <= low).any():
            continue
        into = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        out_of = tuple(slice(a - s, b - s) for a, b, s in zip(low, high, start, strict=True))
        upper[into] = np.maximum(upper[into], estimate.upper[out_of])
    return upper
