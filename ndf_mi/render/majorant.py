"""Local majorants: upper estimates of a field's density in the cells of a grid at one pose, from samples."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field import Preset
from ndf_mi.render.ray_samples import BoundedField, VolumeField
from ndf_mi.render.shell import PARTS, Distances, Grid, reduce_parts, spread

MARGIN = 1.25
"""Factor from the largest density sampled in and next to a cell to the cell's estimate."""

FLOOR = 0.05
"""Smallest estimate in 1/m: free flights divide by it, and gradients need a majorant above every density."""

CHUNK = 1 << 16
"""Samples evaluated at once. The last chunk is filled up, as its size is compiled into the kernels of batched
networks."""


@dataclass(frozen=True)
class Bounds:
    """Upper estimates of a field's density, cell by cell.

    Attributes:
        grid: the cells.
        band: (nx, ny, nz) bool, the cells that the band can touch; the others hold no density.
        upper: (nx, ny, nz) float32 upper estimate in 1/m: from :data:`FLOOR` to `limit` in the band's cells,
            0 in the others.
        seen: (nx, ny, nz) float32 approximate share of the light from outside that reaches each cell
            (:func:`transmittances`).
        limit: the bound that the density's activation gives, in 1/m.
    """

    grid: Grid
    band: np.ndarray
    upper: np.ndarray
    seen: np.ndarray
    limit: float


@dataclass(frozen=True)
class Excess:
    """Samples that were denser than the majorant there.

    Attributes:
        checked: number of samples.
        count: how many of them exceeded the majorant.
        point: (3,) the worst of them, world, metres.
        density, majorant: there, in 1/m.
    """

    checked: int
    count: int
    point: np.ndarray
    density: float
    majorant: float

    def __str__(self) -> str:
        x, y, z = (f"{v:.3f}" for v in self.point)
        return (f"the density at ({x}, {y}, {z}) is {self.density:.4g} per metre, above the majorant "
                f"{self.majorant:.4g}; {self.count} of {self.checked} points exceed theirs")


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
            sigma = volume.evaluate(x, d, located, located.valid).sigma
            result[start : start + count] = sigma.numpy()[:count]
    return result


def bounds(volume: BoundedField, preset: Preset, sampled: Distances, margin: float = MARGIN) -> Bounds:
    """Samples a field's density at the centres of the parts of every cell, and estimates it from above.

    A cell's estimate is `margin` times the largest sample in the cell and in the layer of parts around it: 4³
    samples for a cell of 2³ parts. It is an estimate, not a bound: :func:`exceeding` checks it at other
    points. `sampled` are distances around the field's band at its pose; `margin` is above 1.
    """
    places = sampled.band_places(preset.band, preset.band_inside)
    sigma = np.zeros(sampled.distance.shape, dtype=np.float32)
    sigma.reshape(-1)[places] = densities(volume, sampled.points(places))
    band = sampled.band_cells(preset.band, preset.band_inside)
    upper = np.clip(margin * reduce_parts(spread(sigma), np.maximum), FLOOR, volume.majorant)
    mean = reduce_parts(sigma, np.add) / PARTS**3
    upper = np.where(band, upper, 0).astype(np.float32)
    return Bounds(sampled.grid, band, upper, transmittances(mean, sampled.grid.cell), volume.majorant)


def random_points(grid: Grid, cells: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(count, 3) float64 points, uniform in the cells where (nx, ny, nz) `cells` is true."""
    rng = np.random.default_rng(seed)
    chosen = np.flatnonzero(cells)
    if not len(chosen):
        return np.zeros((0, 3))
    at = np.stack(np.unravel_index(chosen[rng.integers(len(chosen), size=count)], cells.shape), -1)
    return grid.low + (at + rng.random((count, 3))) * grid.cell


def exceeding(points: np.ndarray, sigma: np.ndarray, majorants: np.ndarray) -> Excess | None:
    """Compares densities (N,) at points (N, 3) with the majorants (N,) there; None if none exceeds it."""
    above = sigma > majorants
    if not above.any():
        return None
    worst = int(np.argmax(np.where(above, sigma / np.maximum(majorants, 1e-30), 0)))
    return Excess(len(points), int(above.sum()), points[worst], float(sigma[worst]), float(majorants[worst]))


def transmittances(mean: np.ndarray, cell: float) -> np.ndarray:
    """The approximate share of the light from outside that reaches each cell: the mean transmittance up to
    the cell's centre over beams along ±x, ±y and ±z; (nx, ny, nz) float32 in [0, 1].

    Args:
        mean: (nx, ny, nz) mean densities in 1/m.
        cell: the cells' side, metres.
    """
    total = np.zeros(mean.shape, dtype=np.float32)
    for axis in range(3):
        depth = cell * (np.cumsum(mean, axis) - 0.5 * mean)
        whole = cell * mean.sum(axis, keepdims=True)
        total += np.exp(-depth) + np.exp(depth - whole)
    return total / 6
