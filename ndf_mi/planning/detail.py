"""How fine and how noisy the images are, and how much of the body and of the texture's square they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from ndf_mi.body.body import Body
from ndf_mi.planning.observations import Observations, View, inner_pixels

#: Widths in pixels that images are blurred to, to see what finer detail is worth.
_BLURS = (2, 4, 8)


@dataclass(frozen=True)
class Detail:
    """Resolution, noise and coverage of a capture's training images.

    Attributes:
        noise: upper bound on the standard deviation of the images' noise in sRGB. It comes from mixed second
            differences, which fine texture adds to.
        footprint: metres that a pixel spans on the body, lower quartile.
        uv_footprint: the same in texture coordinates.
        lost: for 2, 4 and 8, the mean squared error in sRGB of images blurred to detail of that many pixels,
            minus noise.
        seen: share of the body's area in triangles that some training image shows.
        atlas: share of the texture's square that those triangles cover.
        parts: share of the area seen of each joint's triangles, which are those that it moves most, by the
            joint's name. Empty if the body has no joints.
    """

    noise: float
    footprint: float
    uv_footprint: float
    lost: dict[int, float]
    seen: float
    atlas: float
    parts: dict[str, float] = field(default_factory=dict)


def detail(body: Body, rest: np.ndarray, observations: Observations, views: Sequence[View]) -> Detail:
    """Measures detail.

    Args:
        rest: (V, 3) the body at rest, metres.
        observations, views: of the training images.
    """
    corners, uv = rest[body.faces], body.uv.astype(np.float64)[body.uv_faces]
    area, uv_area = trimesh.triangles.area(corners), trimesh.triangles.area(uv)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.sqrt(uv_area / area)[observations.triangle]
    uv_footprint = observations.footprint * np.where(np.isfinite(scale), scale, 0)
    noise = _noise(views)
    shown = np.zeros(len(body.faces), dtype=bool)
    shown[observations.triangle] = True
    # Rays hit triangles smaller than a pixel by chance: those within a pixel of a triangle that was hit count
    # too.
    centres, reach = corners.mean(axis=1), float(np.median(observations.footprint))
    shown |= cKDTree(centres[shown]).query(centres, distance_upper_bound=reach)[0] < reach
    return Detail(noise, float(np.quantile(observations.footprint, 0.25)),
                  float(np.quantile(uv_footprint, 0.25)), _lost(views, noise),
                  float(area[shown].sum() / area.sum()), min(float(uv_area[shown].sum()), 1.0),
                  _parts(body, area, shown))


def _parts(body: Body, area: np.ndarray, shown: np.ndarray) -> dict[str, float]:
    if body.weights is None or body.joint_names is None:
        return {}
    joint = body.weights[body.faces].sum(axis=1).argmax(axis=1)
    count = len(body.joint_names)
    seen, every = np.bincount(joint, area * shown, minlength=count), np.bincount(joint, area, minlength=count)
    return {name: float(seen[i] / every[i]) for i, name in enumerate(body.joint_names) if every[i] > 0}


def _noise(views: Sequence[View]) -> float:
    """σ from the median of |x₀₀ − x₀₁ − x₁₀ + x₁₁| / 2, which is 0.6745 σ for white normal noise."""
    parts = []
    for view in views:
        x = view.image.astype(np.float64)
        mixed = (x[:-1, :-1] - x[:-1, 1:] - x[1:, :-1] + x[1:, 1:]) / 2
        parts.append(np.abs(mixed[inner_pixels(view.mask, 2)[:-1, :-1]]).ravel())
    values = np.concatenate(parts)
    # Rounding to 8 bits alone makes this much noise.
    return max(float(np.median(values)) / 0.6745 if len(values) else 0.0, 1 / 255 / np.sqrt(12))


def _lost(views: Sequence[View], noise: float) -> dict[int, float]:
    total, pixels = {blur: 0.0 for blur in _BLURS}, 0
    for view in views:
        inner = inner_pixels(view.mask)
        if not inner.any():
            continue
        pixels += int(inner.sum())
        weight = view.mask.astype(np.float64)[..., None]
        for blur in _BLURS:
            blurred, share = (gaussian_filter(x, (0.5 * blur, 0.5 * blur, 0))
                              for x in (view.image * weight, weight))
            error = (view.image - blurred / np.maximum(share, 1e-6))[inner] ** 2
            total[blur] += float(np.mean(error, axis=1).sum())
    return {blur: max(value / max(pixels, 1) - noise**2, 0.0) for blur, value in total.items()}
