"""A coarse grid over the band's box: which cells the band can touch, and a leaf to begin each cell's searches with."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

Search = Callable[[mi.Point3f, "mi.UInt32 | None", "float | mi.Float", mi.Bool], mi.UInt32]


class Cells:
    """Cells of a quarter of the band over the box [low, high].

    A cell is outside when its centre is farther from the surface than the band and half the cell's diagonal. Every
    other cell knows the leaf of its centre's closest triangle: a search that begins there has a bound to prune with
    that is exact but for the cell's size.

    Args:
        low, high: (3,) float64, the padded box of the band.
        band: δ, metres.
        search: closest triangle within a radius, 2 · leaf + (0 or 1), or 2 · ``none`` without one.
        none: the number that stands for no leaf.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, band: float, search: Search, none: int) -> None:
        side = max(0.25 * band, float((high - low).max()) / 255)
        counts = np.maximum(np.ceil((high - low) / side), 1).astype(np.int64)
        self._low = mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in low))
        self._per_metre = dr.opaque(mi.Float, 1 / side)
        self._counts = mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in counts))
        index = dr.arange(mi.UInt32, int(counts.prod()))
        nx, ny = dr.opaque(mi.UInt32, int(counts[0])), dr.opaque(mi.UInt32, int(counts[1]))
        row = index // nx
        cell = mi.Point3f(mi.Float(index - row * nx), mi.Float(row % ny), mi.Float(row // ny))
        centre = self._low + (cell + 0.5) / self._per_metre
        radius = dr.opaque(mi.Float, band + 0.5 * np.sqrt(3) * side * (1 + 1e-3))
        self._none = dr.opaque(mi.UInt32, none)
        self._leaf = search(centre, None, radius, mi.Bool(True)) // 2
        dr.eval(self._leaf)

    def seed(self, x: mi.Point3f, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """The leaf to begin with, and the active lanes whose cell the band can touch."""
        at = (x - self._low) * self._per_metre
        active = active & dr.all((at >= 0) & (at < self._counts))
        cell = mi.Point3u(dr.select(active, at, 0))
        nx, ny = mi.UInt32(self._counts.x), mi.UInt32(self._counts.y)
        leaf = dr.gather(mi.UInt32, self._leaf, cell.x + nx * (cell.y + ny * cell.z), active)
        return leaf, active & (leaf < self._none)
