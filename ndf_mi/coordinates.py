"""The networks' coordinates: the projected point (u*, v*, l*) by default, and alternatives."""

from __future__ import annotations

from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.field import Preset
from ndf_mi.field.sample import Located
from ndf_mi.projection import aligned


class Coordinates(Protocol):
    """A point of the band as numbers in a unit cube, as many as the preset's `dimension`; attached to
    `located` and to the point."""

    barycentric: bool
    """Whether they use barycentric coordinates of the closest point."""

    def __call__(self, x: mi.Point3f, located: Located, active: mi.Bool) -> list[mi.Float]:
        """Coordinates of the points `x`, which lie at `located`; constants in inactive lanes."""
        ...


class Distance:
    """l as a number in [0, 1]: from −`band_inside` … `band` (`signed`), from |l| (`unsigned`), or of l = 0
    (`none`)."""

    def __init__(self, preset: Preset) -> None:
        self._kind = preset.distance
        self._inside = preset.band_inside
        unsigned = preset.distance == "unsigned"
        self._scale = 1.0 / (preset.band if unsigned else preset.band + preset.band_inside)

    def __call__(self, l: mi.Float) -> mi.Float:
        if self._kind == "unsigned":
            return dr.abs(l) * self._scale
        if self._kind == "none":
            return l * 0.0 + self._inside * self._scale
        return dr.fma(l, self._scale, self._inside * self._scale)


class TexturePoint:
    """(u*, v*, l*): texture coordinates of the closest point, and the distance from it, as in the paper."""

    barycentric = False

    def __init__(self, preset: Preset) -> None:
        self._distance = Distance(preset)

    def __call__(self, x: mi.Point3f, located: Located, active: mi.Bool) -> list[mi.Float]:
        uv = dr.select(active, located.uv, 0.0)
        return [uv.x, uv.y, self._distance(dr.select(active, located.l, 0.0))]


class SurfacePoint:
    """The closest point on the body at rest, (x, y, z) scaled by one factor into the unit cube, and the
    distance from it: four numbers without seams (Xu et al. 2022, *Surface-Aligned Neural Radiance Fields*).

    Args:
        preset: how the distance is given.
        faces: (F, 3) integers into `rest`.
        rest: (V, 3) vertices of the body at rest, in metres.
    """

    barycentric = True

    def __init__(self, preset: Preset, faces: np.ndarray, rest: np.ndarray) -> None:
        self._distance = Distance(preset)
        low, extent = _cube(rest)
        self._corners = aligned(mi.Float(((rest - low) / extent)[faces].astype(np.float32).ravel()))

    def __call__(self, x: mi.Point3f, located: Located, active: mi.Bool) -> list[mi.Float]:
        point = mi.Point3f(0)
        for k in range(3):
            corner = dr.gather(mi.Point3f, self._corners, 3 * located.triangle + k, active)
            point = point + corner * located.barycentric[k]
        point = dr.select(active, point, 0.0)
        return [point.x, point.y, point.z, self._distance(dr.select(active, located.l, 0.0))]


class World:
    """(x, y, z) itself, scaled so that the bands of all poses lie in the unit cube; clamped to it."""

    barycentric = False

    def __init__(self, preset: Preset, poses: Poses) -> None:
        self._low, self._extent = _cube(poses.vertices.reshape(-1, 3), preset.band)

    def __call__(self, x: mi.Point3f, located: Located, active: mi.Bool) -> list[mi.Float]:
        low = mi.Point3f(*[float(v) for v in self._low])
        return list(dr.clip((dr.select(active, x, low) - low) / self._extent, 0.0, 1.0))


def coordinates(preset: Preset, body: Body, poses: Poses) -> Coordinates:
    """The coordinates that a preset's `coordinates` and `distance` name. The body at rest is its `template`,
    or without one the first pose."""
    if preset.coordinates == "surface":
        return SurfacePoint(preset, body.faces, poses.vertices[0] if body.template is None else body.template)
    if preset.coordinates == "world":
        return World(preset, poses)
    return TexturePoint(preset)


def _cube(points: np.ndarray, padding: float = 0.0) -> tuple[np.ndarray, float]:
    """Lower corner (3,) and edge length of a cube around points (N, 3), in metres."""
    low, high = points.min(0).astype(np.float64) - padding, points.max(0).astype(np.float64) + padding
    return low, max(float((high - low).max()), 1e-12)
