"""A coarse grid over the band's box: which cells it can touch, and where searches begin."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.projection.bands import Bands
from ndf_mi.projection.refit import Frame
from ndf_mi.projection.search import Boxes, any_within, closest_pair, pending

BLOCK = 4
"""Cells along a block's side. Cells are numbered block by block, so that close numbers are close in space."""

SLACK = 0.2
"""Cells need not begin at the closest leaf; they may begin at one that is farther by this fraction."""


class Cells:
    """Cells of about a quarter of the band over the box [low, high]; of its typical width, where it varies.

    Every cell that a point of the band can lie in stores a leaf that is almost the closest to its centre, and
    which parts of the tree can hold a closer one for any point of the cell
    rules out.

    Args:
        low, high: (3,) float64, the padded box of the band, metres.
        band: δ, metres; the largest where it varies.
        frame, boxes: the tree to search.
        bands: None for a band of one width.

    Attributes:
        count: cells in the blocks that the band can touch; the box has at least one such block.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, band: float, frame: Frame, boxes: Boxes,
                 bands: Bands | None = None) -> None:
        self._bands = bands
        side = max(0.3 * (band if bands is None else bands.typical), float((high - low).max()) / 256)
        blocks = np.ceil((high - low) / (BLOCK * side)).astype(np.int64)
        self._low = mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in low))
        self._per_metre = dr.opaque(mi.Float, 1 / side)
        self._blocks = mi.Vector3u(*(dr.opaque(mi.UInt32, int(c)) for c in blocks))

        block = dr.arange(mi.UInt32, int(blocks.prod()))
        centre = BLOCK * self._block_corner(block) + 0.5 * BLOCK
        root = dr.full(mi.UInt32, 1, len(block))
        node, trail = self._begin(centre, 0.5 * BLOCK, band, frame, boxes, root, mi.UInt32(0))
        dr.eval(node, trail)

        touched = dr.compress(node != 0)
        self._rank = dr.zeros(mi.UInt32, len(block))
        dr.scatter(self._rank, dr.arange(mi.UInt32, len(touched)) + 1, touched)
        self.count = len(touched) * BLOCK**3
        index = dr.arange(mi.UInt32, self.count)
        local, block = index % BLOCK**3, dr.gather(mi.UInt32, touched, index // BLOCK**3)
        within = mi.Point3f(mi.Point3u(local % BLOCK, local // BLOCK % BLOCK, local // BLOCK**2))
        begin = dr.gather(mi.UInt32, node, block), dr.gather(mi.UInt32, trail, block)
        centre = BLOCK * self._block_corner(block) + within + 0.5
        self._node, self._trail = self._begin(centre, 0.5, band, frame, boxes, *begin)
        dr.eval(self._rank, self._node, self._trail)

    def locate(self, x: mi.Point3f) -> tuple[mi.UInt32, mi.Bool]:
        """The number of the cell of x, below ``count``, and whether there is one."""
        at = (x - self._low) * self._per_metre
        inside = dr.all((at >= 0) & (at < BLOCK * mi.Vector3f(self._blocks)))
        cell = mi.Point3u(dr.select(inside, at, 0))
        block, local = cell // BLOCK, cell % BLOCK
        number = block.x + self._blocks.x * (block.y + self._blocks.y * block.z)
        rank = dr.gather(mi.UInt32, self._rank, number, inside)
        inside &= rank != 0
        return (rank - 1) * BLOCK**3 + local.x + BLOCK * (local.y + BLOCK * local.z), inside

    def start(self, cell: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
        """Node and trail with which a search from the cell begins; node 0 off the band."""
        return dr.gather(mi.UInt32, self._node, cell, active), dr.gather(mi.UInt32, self._trail, cell, active)

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """Whether the band can touch the cell of x."""
        cell, inside = self.locate(x)
        return dr.gather(mi.UInt32, self._node, cell, inside) != 0

    def _block_corner(self, block: mi.UInt32) -> mi.Point3f:
        row = block // self._blocks.x
        y, z = row % self._blocks.y, row // self._blocks.y
        return mi.Point3f(mi.Point3u(block - row * self._blocks.x, y, z))

    def _begin(
        self, centre: mi.Point3f, half: float, band: float, frame: Frame, boxes: Boxes, node: mi.UInt32,
        trail: mi.UInt32,
    ) -> tuple[mi.UInt32, mi.UInt32]:
        """Where searches from cubes begin; their centres and half their side are given in cells."""
        q = frame.to_units(self._low + centre / self._per_metre)
        reach = half * (1 + 1e-3) / self._per_metre * frame.scale
        corner = math.sqrt(3) * reach
        band_units = dr.opaque(mi.Float, band * (1 + 1e-3)) * frame.scale
        farthest = band_units + corner
        best2, found = closest_pair(boxes, q, farthest * farthest, node, trail, SLACK)
        touched = found < 2 * boxes.leaves
        leaf = dr.select(touched, found // 2, 0)
        bound = dr.minimum(dr.sqrt(best2) + corner, band_units)
        trail = pending(boxes, q, reach, leaf, bound)
        if self._bands is not None:
            begin = dr.select(touched, leaf + boxes.leaves, 0), dr.select(touched, trail, 0)
            scale = frame.scale * (1 + 1e-3)
            touched = any_within(boxes, q, self._bands.reach, scale, corner, *begin)
        return dr.select(touched, leaf + boxes.leaves, 0), dr.select(touched, trail, 0)
