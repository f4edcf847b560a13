"""Local majorants: upper estimates of a field's density in the cells of a grid, at one pose, from samples."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field import Preset
from ndf_mi.render.ray_samples import BoundedField, VolumeField
from ndf_mi.render.shell import PARTS, Grid, Lattice, reduce_parts, spread

MARGIN = 1.25
"""Factor from the largest density sampled in and next to a cell to its estimate."""

FLOOR = 0.05
"""Least estimate in 1/m: free flights divide by it, and gradients need a majorant above every density."""

CHUNK = 1 << 16
"""Samples evaluated at once; the last of them are filled up, as batched networks have their number compiled into kernels."""


@dataclass(frozen=True)
class Bounds:
    """A field's density cell by cell, as far as samples tell.

    Attributes:
        grid: the cells.
        band: (nx, ny, nz) bool, the cells that the band can touch: the others hold no density.
        upper: (nx, ny, nz) float32 upper estimate in 1/m, at least :data:`FLOOR` in the band's cells, 0 in the others, and never above
            `limit`.
        seen: (nx, ny, nz) float32 share of the light from outside that reaches each cell, roughly (:func:`transmittances`).
        limit: the bound that the density's activation gives, in 1/m.
    """

    grid: Grid
    band: np.ndarray
    upper: np.ndarray
    seen: np.ndarray
    limit: float


@dataclass(frozen=True)
class Excess:
    """Where samples were denser than a majorant.

    Attributes:
        checked: how many samples there were.
        count: how many of them were above it.
        point: (3,) the worst of them, world, metres; `density` there and the `majorant`, in 1/m.
    """

    checked: int
    count: int
    point: np.ndarray
    density: float
    majorant: float

    def __str__(self) -> str:
        x, y, z = (f"{v:.3f}" for v in self.point)
        return (f"the density at ({x}, {y}, {z}) is {self.density:.4g} per metre, above the majorant {self.majorant:.4g} there; "
                f"so were {self.count} of {self.checked} points")


def densities(volume: VolumeField, points: np.ndarray) -> np.ndarray:
    """(N,) float32 densities in 1/m at points (N, 3) in metres, world; zero outside the field."""
    result = np.zeros(len(points), dtype=np.float32)
    d = mi.Vector3f(dr.zeros(mi.Float, CHUNK), 0.0, 1.0)
    with dr.suspend_grad():
        for start in range(0, len(points), CHUNK):
            count = min(CHUNK, len(points) - start)
            padded = np.resize(points[start : start + count].astype(np.float32), (CHUNK, 3))
            x = mi.Point3f(padded.T)
            located = volume.locate(x, volume.may_contain(x))
            dr.eval(located)
            result[start : start + count] = volume.evaluate(x, d, located, located.valid).sigma.numpy()[:count]
    return result


def bounds(model: BoundedField, preset: Preset, sampled: Lattice, margin: float = MARGIN) -> Bounds:
    """Samples a field's density at the middles of the parts of every cell, and estimates it from above.

    A cell's estimate is `margin` times the largest sample in the cell and in the layer of parts around it, 4³ samples for a cell of 2³.
    It is an estimate, not a proof: :func:`exceeding` checks it at other points.

    Args:
        model: the field at the pose that `sampled` is of.
        preset: the field's.
        sampled: the lattice around its band.
        margin: factor, above 1.
    """
    inside = sampled.distance.reshape(-1)[sampled.places]
    some = (inside <= preset.band) & (inside >= -preset.band_inside)
    places = sampled.places[some]
    sigma = np.zeros(sampled.distance.shape, dtype=np.float32)
    sigma.reshape(-1)[places] = densities(model, sampled.points(places))
    band = sampled.band_cells(preset.band, preset.band_inside)
    upper = np.clip(margin * reduce_parts(spread(sigma), np.maximum), FLOOR, model.majorant)
    mean = reduce_parts(sigma, np.add) / PARTS**3
    return Bounds(sampled.grid, band, np.where(band, upper, 0).astype(np.float32), transmittances(mean, sampled.grid.cell), model.majorant)


def random_points(grid: Grid, cells: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(count, 3) float64 points, uniform in the cells where (nx, ny, nz) `cells` is true; none if it is nowhere."""
    rng = np.random.default_rng(seed)
    chosen = np.flatnonzero(cells)
    if not len(chosen):
        return np.zeros((0, 3))
    at = np.stack(np.unravel_index(chosen[rng.integers(len(chosen), size=count)], cells.shape), -1)
    return grid.low + (at + rng.random((count, 3))) * grid.cell


def exceeding(points: np.ndarray, sigma: np.ndarray, majorants: np.ndarray) -> Excess | None:
    """Compares densities (N,) at points (N, 3) with the majorants (N,) there; None where none is above its own."""
    above = sigma > majorants
    if not above.any():
        return None
    worst = int(np.argmax(np.where(above, sigma / np.maximum(majorants, 1e-30), 0)))
    return Excess(len(points), int(above.sum()), points[worst], float(sigma[worst]), float(majorants[worst]))


def transmittances(mean: np.ndarray, cell: float) -> np.ndarray:
    """How much of the light from outside reaches each cell: the mean over beams along ±x, ±y and ±z of the transmittance up to the cell's
    middle, (nx, ny, nz) float32 in [0, 1], of mean densities in 1/m."""
    total = np.zeros(mean.shape, dtype=np.float32)
    for axis in range(3):
        depth = cell * (np.cumsum(mean, axis) - 0.5 * mean)
        whole = cell * mean.sum(axis, keepdims=True)
        total += np.exp(-depth) + np.exp(depth - whole)
    return total / 6
