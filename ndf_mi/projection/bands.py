"""A band whose width varies over the surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.projection.surface import Surface, aligned


class Bands:
    """How far a band reaches from each place of a surface, outside and inside.

    Widths are given at the vertices and linear over each triangle: those of a point x are the widths at the
    point of the surface that is closest to it. They belong to the surface, whatever its pose.

    Args:
        surface: the surface.
        widths: (V, 2) metres above 0, outside and inside.

    Attributes:
        widths: (V, 2) float32.
        largest: (V,) float32, the larger of the two.
        outside, inside: the largest widths of all vertices, metres.
        typical: the median over vertices of the larger of the two, metres.
        reach, reach_inside: for each node of the search tree, numbered as in
            :class:`ndf_mi.projection.surface.Tree`, the largest width of the vertices below it in metres: of
            both, and inside alone. Entry 0 is not used.

    Raises:
        InputError: the widths' shape differs, or one is not finite and above 0.
    """

    def __init__(self, surface: Surface, widths: np.ndarray) -> None:
        widths = np.ascontiguousarray(widths, np.float32)
        if widths.shape != (surface.vertex_count, 2):
            expected = f"({surface.vertex_count}, 2), outside and inside at every vertex"
            raise InputError("bands", f"shape {widths.shape}", expected)
        wrong = np.flatnonzero(~(np.isfinite(widths) & (widths > 0)).all(axis=1))
        if len(wrong):
            raise InputError(f"bands: vertex {wrong[0]}", f"{widths[wrong[0]].tolist()}",
                             "two distances above 0, in metres")
        self.widths = widths
        self.largest = widths.max(axis=1)
        self.outside, self.inside = (float(width) for width in widths.max(axis=0))
        self.typical = float(np.median(self.largest))
        self._flat = aligned(mi.Float(widths.ravel()))
        self._surface = surface
        self.reach = _over_nodes(surface, self.largest)
        self.reach_inside = _over_nodes(surface, widths[:, 1])

    def widened(self, by: float) -> Bands:
        """The same with `by` metres more on either side."""
        return Bands(self._surface, self.widths + np.float32(by))

    def at(self, corner: list[mi.UInt32], weights: mi.Point3f, active: mi.Bool) -> mi.Point2f:
        """The widths at points of triangles, outside and inside, in metres: attached to the weights.

        Args:
            corner: the triangles' three vertices.
            weights: barycentric weights of the points.
        """
        total = mi.Point2f(0)
        for k in range(3):
            total = total + dr.gather(mi.Point2f, self._flat, corner[k], active) * weights[k]
        return total


def _over_nodes(surface: Surface, width: np.ndarray) -> mi.Float:
    """The largest of (V,) values below each node of the search tree."""
    level = width[surface.leaf_corners.numpy().reshape(-1, 4)].max(axis=1)
    levels = [level]
    while len(level) > 1:
        level = level.reshape(-1, 2).max(axis=1)
        levels.append(level)
    return aligned(mi.Float(np.concatenate([np.zeros(1, np.float32), *levels[::-1]])))
