"""What the networks take for a place: the projected point (u*, v*, l*) by default, and alternatives."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.field import Preset
from ndf_mi.field.sample import Located
from ndf_mi.projection import aligned


class Coordinates:
    """A point of the band as numbers in a unit cube, as many as the preset's `dimension`, by the preset's
    `coordinates`:

    - `uv`: texture coordinates of the closest point, and l, as in the paper;
    - `surface`: the closest point on the body at rest, (x, y, z) scaled by one factor, and l: four numbers
      without seams (Xu et al. 2022, *Surface-Aligned Neural Radiance Fields*);
    - `world`: (x, y, z) itself, scaled so that the bands of all poses lie in the unit cube; clamped to it.

    l becomes a number in [0, 1]: from −`band_inside` … `band`, from |l|, or of l = 0, by the preset's
    `distance`. The body at rest is its `template`, or without one the first pose.

    Attributes:
        barycentric: whether they use barycentric coordinates of the closest point.
    """

    def __init__(self, preset: Preset, body: Body, poses: Poses) -> None:
        self._kind = preset.coordinates
        self._distance = preset.distance
        self._inside = preset.band_inside
        unsigned = preset.distance == "unsigned"
        self._scale = 1.0 / (preset.band if unsigned else preset.band + preset.band_inside)
        self.barycentric = preset.coordinates == "surface"
        if self._kind == "surface":
            rest = poses.vertices[0] if body.template is None else body.template
            low, extent = _cube(rest)
            corners = ((rest - low) / extent)[body.faces]
            self._corners = aligned(mi.Float(corners.astype(np.float32).ravel()))
        elif self._kind == "world":
            self._low, self._extent = _cube(poses.vertices.reshape(-1, 3), preset.band)

    def __call__(self, x: mi.Point3f, located: Located, active: mi.Bool) -> list[mi.Float]:
        """Coordinates of the points `x`, which lie at `located`, attached to both; constants in inactive
        lanes."""
        if self._kind == "world":
            low = mi.Point3f(*[float(v) for v in self._low])
            return list(dr.clip((dr.select(active, x, low) - low) / self._extent, 0.0, 1.0))
        if self._kind == "uv":
            place = dr.select(active, located.uv, 0.0)
        else:
            point = mi.Point3f(0)
            for k in range(3):
                corner = dr.gather(mi.Point3f, self._corners, 3 * located.triangle + k, active)
                point = point + corner * located.barycentric[k]
            place = dr.select(active, point, 0.0)
        return [*place, self._along(dr.select(active, located.l, 0.0))]

    def _along(self, l: mi.Float) -> mi.Float:
        if self._distance == "unsigned":
            return dr.abs(l) * self._scale
        if self._distance == "none":
            return l * 0.0 + self._inside * self._scale
        return dr.fma(l, self._scale, self._inside * self._scale)


def _cube(points: np.ndarray, padding: float = 0.0) -> tuple[np.ndarray, float]:
    """Lower corner (3,) and edge length of a cube around points (N, 3), in metres."""
    low, high = points.min(0).astype(np.float64) - padding, points.max(0).astype(np.float64) + padding
    return low, max(float((high - low).max()), 1e-12)
