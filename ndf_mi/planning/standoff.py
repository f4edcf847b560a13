"""How far the performer's surface stands off the body, from rays on which mask and body disagree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.planning.observations import View
from ndf_mi.projection import PosedSurface, Surface

#: Largest distance from the body that is measured, in metres; larger ones count as this.
REACH = 0.25
#: Points along a ray where the distance is measured, one to two centimetres apart. The error is a millimetre
#: where the distance is a centimetre.
_POINTS = 160
#: Rays in one kernel launch.
_RAYS = 1 << 16


@dataclass(frozen=True)
class Disagreement:
    """Pixels of one kind.

    Attributes:
        distance: (K,) metres, at least 0.
        cost: (K,) squared error in sRGB of leaving each out.
        triangle: (K,) int, the body's triangle that the distance is from, -1 where it is above :data:`REACH`.
    """

    distance: np.ndarray
    cost: np.ndarray
    triangle: np.ndarray

    def reach(self, allowed: float) -> float:
        """The smallest distance in metres beyond which all pixels together cost at most `allowed`."""
        order = np.argsort(-self.distance)
        beyond = np.cumsum(self.cost[order]) > allowed
        return float(self.distance[order][beyond.argmax()]) if beyond.any() else 0.0


@dataclass(frozen=True)
class Standoff:
    """Where the masks are larger than the body's silhouette, and where smaller.

    Attributes:
        outside: mask pixels off the body, by the smallest distance of their rays from the body: what they
            show is at least that far off it.
        inside: body pixels off the mask, by the largest depth of their rays in the body: what is seen
            elsewhere lies at least that deep.
        pixels: number of mask pixels.
    """

    outside: Disagreement
    inside: Disagreement
    pixels: int


def standoff(capture: Capture, frames: Sequence[int], views: Sequence[View]) -> Standoff:
    """Compares masks and bodies.

    Args:
        frames: the frames that the views' indices refer to.
        views: training images.
    """
    surface = Surface(capture.body.faces, capture.body.uv, capture.body.uv_faces, capture.poses.vertices[0])
    cameras = [capture.cameras[name] for name in capture.splits["train"].cameras]
    shown = sum(int(view.mask.sum()) for view in views)
    squared = sum(float(((view.image[view.mask] - capture.background) ** 2).mean(axis=1).sum())
                  for view in views)
    # The mean squared difference of the performer from the background.
    contrast = squared / max(shown, 1)
    none = (np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    outside, inside = [none], [none]
    for row, frame in enumerate(frames):
        vertices = capture.poses.vertices[capture.poses.index(frame)]
        posed = PosedSurface(surface, mi.Float(vertices.ravel()), REACH)
        for view in (view for view in views if view.frame == row):
            camera = cameras[view.camera]
            pixels = np.flatnonzero((view.mask & ~view.body).ravel())
            cost = np.mean((view.image.reshape(-1, 3)[pixels] - capture.background) ** 2, axis=1)
            distance, triangle = _smallest_distance(posed, camera, pixels)
            outside.append((np.maximum(distance, 0), cost, triangle))
            pixels = np.flatnonzero((view.body & ~view.mask).ravel())
            distance, triangle = _smallest_distance(posed, camera, pixels)
            inside.append((np.maximum(-distance, 0), np.full(len(pixels), contrast), triangle))
    return Standoff(_joined(outside), _joined(inside), shown)


def _joined(parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Disagreement:
    return Disagreement(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _smallest_distance(posed: PosedSurface, camera: Camera,
                       pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) smallest signed distance in metres along each pixel's ray, at most `REACH`; and (N,) the triangle
    that it is from, -1 where it is `REACH`."""
    low, high = (np.array(corner, dtype=np.float64).ravel() for corner in (posed.bbox.min, posed.bbox.max))
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    smallest, triangles = [np.zeros(0)], [np.zeros(0, np.int64)]
    for first in range(0, len(pixels), _RAYS):
        y, x = np.divmod(pixels[first : first + _RAYS], camera.w)
        ray = camera.rays(mi.Point2f(mi.Float(x), mi.Float(y)) + 0.5)
        origin, direction = np.array(ray.o).T.astype(np.float64), np.array(ray.d).T.astype(np.float64)
        with np.errstate(divide="ignore"):
            a, b = (low - origin) / direction, (high - origin) / direction
        near, far = np.maximum(np.minimum(a, b).max(axis=1), 0), np.maximum(a, b).min(axis=1)
        t = near[:, None] + np.maximum(far - near, 0)[:, None] * share
        points = (origin[:, None] + t[..., None] * direction[:, None]).reshape(-1, 3)
        found = posed.project(mi.Point3f(np.ascontiguousarray(points.T, dtype=np.float32)))
        valid = np.array(found.valid)
        distance = np.where(valid, np.array(found.l), REACH).reshape(-1, _POINTS)
        triangle = np.where(valid, np.array(found.triangle, np.int64), -1).reshape(-1, _POINTS)
        least = distance.argmin(axis=1)[:, None]
        smallest.append(np.take_along_axis(distance, least, 1)[:, 0].astype(np.float64))
        triangles.append(np.take_along_axis(triangle, least, 1)[:, 0])
    return np.concatenate(smallest), np.concatenate(triangles)
