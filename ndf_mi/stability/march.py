"""What rays see of the ridge around the ball, in float64: the same strata, the closest of all triangles, the density's formula."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndf_mi.colour import srgb_to_linear
from ndf_mi.stability.ball import PEAK, Ridge
from ndf_mi.stability.closest import closest, inside


@dataclass(frozen=True)
class Sight:
    """Of N rays: `opacity` and `depth`, 0 where nothing is met (N,), and the `slope` of the opacity in the density's PEAK (N,)."""

    opacity: np.ndarray
    depth: np.ndarray
    slope: np.ndarray


def interval(origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays (N, 3) are in an axis-aligned box in front of their origins: (N,) near and far, both 0 where they miss it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    near, far = np.maximum(np.fmin(a, b).max(1), 0), np.fmax(a, b).min(1)
    hit = far > near
    return np.where(hit, near, 0), np.where(hit, far, 0)


def march(ridge: Ridge, origin: np.ndarray, direction: np.ndarray, samples: int) -> Sight:
    """Quadrature along rays, origins and unit directions (N, 3), with as many equal strata as the renderer takes."""
    origin, direction = origin.astype(np.float64), direction.astype(np.float64)
    box = ridge.run.surface(0).bbox
    low, high = (np.array(corner, np.float64).ravel() for corner in (box.min, box.max))
    # Strata are of the box's own interval; that it lacks nothing of the band is not taken from it.
    step = np.spacing(np.abs(ridge.vertices).max(0)).astype(np.float64)
    places = ridge.vertices.astype(np.float64)
    if (low > places.min(0) - ridge.preset.band + step).any() or (high < places.max(0) + ridge.preset.band - step).any():
        raise ValueError("the box does not contain the band")
    near, far = interval(origin, direction, low, high)
    delta = (far - near) / samples
    t = near[:, None] + (np.arange(samples) + 0.5) * delta[:, None]
    x = origin[:, None] + direction[:, None] * t[:, :, None]
    l = np.full(t.size, np.inf)
    # Only what can be in the band is worth looking for.
    middle = ridge.vertices.astype(np.float64).mean(0)
    reach = np.linalg.norm(ridge.vertices - middle, axis=1).max() + 1.01 * ridge.preset.band
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
    before = np.cumsum(tau, 1) - tau
    weight = np.exp(-before) * -np.expm1(-tau)
    opacity = -np.expm1(-tau.sum(1))
    return Sight(opacity, (weight * t).sum(1) / np.maximum(opacity, 1e-6), np.exp(-tau.sum(1)) * by_peak)


def linear(srgb: float) -> float:
    """The linear value of an sRGB one."""
    return float(srgb_to_linear(srgb))
