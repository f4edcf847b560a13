"""The tree's boxes in one pose, and the units that they are written in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.projection.search import UNITS, WORDS

if TYPE_CHECKING:
    from ndf_mi.projection.surface import Surface


class Frame:
    """The search's coordinates: relative to the box of the posed mesh, ``UNITS`` along its longest side.

    Boxes then fit 16 bits a bound, rounded outwards; and far from the world's origin no precision is lost.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        side = max(float((high - low).max()), 1e-12)
        self.origin = mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in low))
        # a hair less than fits, as the scaling rounds
        self.scale = dr.opaque(mi.Float, UNITS * (1 - 1e-6) / side)

    def to_units(self, x: mi.Point3f) -> mi.Point3f:
        return mi.Point3f((x - self.origin) * self.scale)


def refit(surface: Surface, vertices: mi.Float, frame: Frame) -> tuple[mi.UInt32, mi.Float]:
    """Boxes of all nodes and coordinates of all leaves, as :func:`ndf_mi.projection.search.closest_pair` reads them."""
    leaves = surface.leaves
    leaf = dr.arange(mi.UInt32, leaves)
    corners = dr.empty(mi.Float, 12 * leaves)
    low, high = mi.Point3f(UNITS), mi.Point3f(0)
    for k in range(4):
        vertex = dr.gather(mi.UInt32, surface.leaf_corners, 4 * leaf + k)
        point = frame.to_units(dr.gather(mi.Point3f, vertices, vertex))
        dr.scatter(corners, point, 4 * leaf + k)
        low, high = dr.minimum(low, point), dr.maximum(high, point)
    low = dr.select(surface.leaf_occupied, dr.clip(dr.floor(low), 0, UNITS), UNITS)
    high = dr.select(surface.leaf_occupied, dr.clip(dr.ceil(high), 0, UNITS), 0)
    words = [mi.UInt32(low[k]) | (mi.UInt32(high[k]) << 16) for k in range(3)]
    dr.eval(corners, words)

    nodes = dr.zeros(mi.UInt32, WORDS * leaves)
    for level in reversed(range(surface.depth)):
        count = 1 << level
        node = dr.arange(mi.UInt32, count)
        above = []
        for k in range(3):
            left, right = dr.gather(mi.UInt32, words[k], 2 * node), dr.gather(mi.UInt32, words[k], 2 * node + 1)
            dr.scatter(nodes, left, (node + count) * WORDS + k)
            dr.scatter(nodes, right, (node + count) * WORDS + 3 + k)
            lower = dr.minimum(left & 0xFFFF, right & 0xFFFF)
            above.append(lower | dr.maximum(left & 0xFFFF0000, right & 0xFFFF0000))
        words = above
        dr.eval(nodes, words)
    return nodes, corners
