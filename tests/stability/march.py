"""What rays see of a ridge, in float64: the renderer's intervals, the closest triangle, the density's
formula."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndf_mi.stability.ball import PEAK, Ridge
from ndf_mi.stability.closest import closest, inside


@dataclass(frozen=True)
class Seen:
    """What N rays see: `opacity` and `depth`, 0 for rays that miss, and the `slope` of the opacity in the
    density's PEAK, each (N,)."""

    opacity: np.ndarray
    depth: np.ndarray
    slope: np.ndarray


def interval(
    origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays (N, 3) are in an axis-aligned box in front of their origins: (N,) near and far, both 0 for
    rays that miss it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    near, far = np.maximum(np.fmin(a, b).max(1), 0), np.fmax(a, b).min(1)
    hit = far > near
    return np.where(hit, near, 0), np.where(hit, far, 0)


def march(ridge: Ridge, origin: np.ndarray, direction: np.ndarray, samples: int) -> Seen:
    """Quadrature along rays, origins and unit directions (N, 3), in the renderer's intervals.

    Raises:
        ValueError: the box of the run's surface does not contain the band.
    """
    origin, direction = origin.astype(np.float64), direction.astype(np.float64)
    places = ridge.vertices.astype(np.float64)
    # The renderer divides the rays' way through its own box, so that box is used. That it contains the band
    # is checked.
    box = ridge.run.surface(0).bbox
    low, high = (np.array(corner, np.float64).ravel() for corner in (box.min, box.max))
    rounding = np.spacing(np.abs(ridge.vertices).max(0)).astype(np.float64)
    band = ridge.preset.band - rounding
    if (low > places.min(0) - band).any() or (high < places.max(0) + band).any():
        raise ValueError("the box does not contain the band")
    near, far = interval(origin, direction, low, high)
    delta = (far - near) / samples
    t = near[:, None] + (np.arange(samples) + 0.5) * delta[:, None]
    x = origin[:, None] + direction[:, None] * t[:, :, None]
    l = np.full(t.size, np.inf)
    # Distances are needed only for points that may be in the band.
    middle = places.mean(0)
    reach = np.linalg.norm(places - middle, axis=1).max() + 1.01 * ridge.preset.band
    some = (np.linalg.norm(x - middle, axis=2) < reach).ravel() & np.repeat(far > near, samples)
    points = x.reshape(-1, 3)[some]
    if len(points):
        distance = closest(points, ridge.vertices, ridge.faces).distance
        l[some] = np.where(inside(points, ridge.vertices, ridge.faces), -distance, distance)
    l = l.reshape(t.shape)

    def depths(peak: float) -> np.ndarray:
        known = np.isfinite(l)
        return np.where(known, ridge.density(np.where(known, l, 0.0), peak), 0.0) * delta[:, None]

    tau = depths(PEAK)
    step = 1e-5
    by_peak = (depths(PEAK + step) - depths(PEAK - step)).sum(1) / (2 * step)
    weight = np.exp(tau - np.cumsum(tau, 1)) * -np.expm1(-tau)
    opacity = -np.expm1(-tau.sum(1))
    return Seen(opacity, (weight * t).sum(1) / np.maximum(opacity, 1e-6), np.exp(-tau.sum(1)) * by_peak)
