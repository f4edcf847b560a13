"""Where in (u, v, l) a field in training is dense; its empty parts need not be evaluated."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

_UNTIL_EMPTY = 150
"""Steps after which a cell that no sample has reached counts as empty."""


class Occupancy:
    """A coarse grid over the unit cube of (u, v, l) with a decaying maximum of the densities seen in each
    cell, over all poses (after Müller et al. 2022, who use world space).

    A random share p of the samples in empty cells is kept, so that a cell that becomes dense is noticed. Each
    of these counts 1/p times, for those that are skipped: optical depths keep their mean, and thin fog still
    fades.

    Args:
        threshold: densities in 1/m below which a cell counts as empty.
        resolution: cells along u, v and l.
        decay: factor on all cells at each step.
        explore: share of the samples in empty cells that are kept.
    """

    def __init__(
        self, threshold: float, resolution: tuple[int, int, int] = (128, 128, 24), decay: float = 0.99,
        explore: float = 0.125,
    ) -> None:
        self._threshold = threshold
        self._resolution = resolution
        self._decay = decay
        self.explore = explore
        self._salt = 0
        # All cells start occupied, and stay so for the first steps even without samples.
        self.values = dr.full(mi.Float, threshold / decay**_UNTIL_EMPTY, int(np.prod(resolution)))
        dr.make_opaque(self.values)

    def keep(self, u: mi.Point3f) -> tuple[mi.Bool, mi.Float]:
        """Which points of the unit cube to evaluate (all in occupied cells, a random few of the others), and
        how many points each stands for: 1 in occupied cells, 1 / `explore` in the others."""
        with dr.suspend_grad():
            occupied = dr.gather(mi.Float, self.values, self._cell(u)) > self._threshold
            # The default of four rounds keeps 3 % too many of neighbouring numbers.
            lane, salt = dr.arange(mi.UInt32, dr.width(u)), dr.opaque(mi.UInt32, self._salt)
            chance = mi.sample_tea_float32(lane, salt, 8)
            return occupied | (chance < self.explore), dr.select(occupied, mi.Float(1.0), 1.0 / self.explore)

    def observe(self, u: mi.Point3f, sigma: mi.Float, active: mi.Bool) -> None:
        """Updates the grid with the densities of a step's samples."""
        with dr.suspend_grad():
            values = self.values * self._decay
            dr.scatter_reduce(dr.ReduceOp.Max, values, dr.detach(sigma), self._cell(dr.detach(u)), active)
            self.values = values
            dr.eval(self.values)
        self._salt += 1

    def restore(self, values: np.ndarray, step: int) -> None:
        """Sets the cells' values and the steps observed; ValueError if the number of values is wrong."""
        if values.shape != (int(np.prod(self._resolution)),):
            raise ValueError(f"{values.shape} occupancy values")
        self.values = mi.Float(values.astype(np.float32))
        self._salt = step

    def _cell(self, u: mi.Point3f) -> mi.UInt32:
        nx, ny, nz = self._resolution

        def index(x: mi.Float, n: int) -> mi.UInt32:
            return mi.UInt32(dr.clip(x * n, 0.0, n - 1.0))

        return (index(u.z, nz) * ny + index(u.y, ny)) * nx + index(u.x, nx)
