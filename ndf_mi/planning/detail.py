"""How fine the images are and how noisy, what of the body they show, and how much of the texture's square that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter
from scipy.spatial import cKDTree

from ndf_mi.body.body import Body
from ndf_mi.planning.observations import Observations, View

#: Texels a side of the raster that the texture's square is measured on.
_RASTER = 512
#: Blurs that images are tried with: by how many times finer detail is taken away.
_BLURS = (2, 4, 8)


@dataclass(frozen=True)
class Detail:
    """Attributes:
        noise: standard deviation of the images' noise in sRGB, at most: from mixed second differences, which fine texture enters too.
        footprint: metres that a pixel spans on the body, where it is seen best (the lower quartile).
        texel: the same in units of the texture's square.
        lost: for 2, 4 and 8, the mean squared error in sRGB of images blurred to detail that many pixels wide, less that of their noise.
        seen: share of the body's area in triangles that some training image shows.
        atlas: share of the texture's square that those triangles cover.
        parts: share of the area seen of what each joint moves, by its name: of each triangle the joint that moves it most. Empty where the
            body has no joints.
    """

    noise: float
    footprint: float
    texel: float
    lost: dict[int, float]
    seen: float
    atlas: float
    parts: dict[str, float] = field(default_factory=dict)


def detail(body: Body, rest: np.ndarray, seen: Observations, views: Sequence[View]) -> Detail:
    """From observations, and the images that they come from.

    Args:
        rest: (V, 3) the body at rest, metres.
    """
    corners, texels = rest[body.faces], body.uv.astype(np.float64)[body.uv_faces]
    area, uv_area = _areas(corners), _areas(np.concatenate([texels, np.zeros((*texels.shape[:2], 1))], axis=2))
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.sqrt(uv_area / area)[seen.triangle]
    size = seen.footprint * np.where(np.isfinite(scale), scale, 0)
    noise = _noise(views)
    shown = np.zeros(len(body.faces), dtype=bool)
    shown[seen.triangle] = True
    # Triangles smaller than a pixel are hit by chance: those around them that lie within a pixel of one that is hit are seen too.
    shown |= _near(corners.mean(axis=1), shown, float(np.median(seen.footprint)))
    return Detail(noise, float(np.quantile(seen.footprint, 0.25)), float(np.quantile(size, 0.25)), _lost(views, noise),
                  float(area[shown].sum() / area.sum()), min(float(uv_area[shown].sum()), 1.0), _parts(body, area, shown))


def _parts(body: Body, area: np.ndarray, shown: np.ndarray) -> dict[str, float]:
    if body.weights is None or body.joint_names is None:
        return {}
    joint = body.weights[body.faces].sum(axis=1).argmax(axis=1)
    count = len(body.joint_names)
    seen, every = np.bincount(joint, area * shown, minlength=count), np.bincount(joint, area, minlength=count)
    return {name: float(seen[i] / every[i]) for i, name in enumerate(body.joint_names) if every[i] > 0}


def _areas(corners: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _near(points: np.ndarray, chosen: np.ndarray, reach: float) -> np.ndarray:
    return np.asarray(cKDTree(points[chosen]).query(points, distance_upper_bound=reach)[0] < reach)


def _noise(views: Sequence[View]) -> float:
    """σ from the median of |x₀₀ − x₀₁ − x₁₀ + x₁₁| / 2 within the masks, which is 0.6745 σ where the noise is white and normal."""
    parts = []
    for view in views:
        x = view.image.astype(np.float64)
        mixed = (x[:-1, :-1] - x[:-1, 1:] - x[1:, :-1] + x[1:, 1:]) / 2
        parts.append(np.abs(mixed[_inner(view.mask, 2)[:-1, :-1]]).ravel())
    values = np.concatenate(parts)
    # What was rounded to 8 bits has at least that much noise.
    return max(float(np.median(values)) / 0.6745 if len(values) else 0.0, 1 / 255 / np.sqrt(12))


def _lost(views: Sequence[View], noise: float) -> dict[int, float]:
    total, pixels = {blur: 0.0 for blur in _BLURS}, 0
    for view in views:
        inner = _inner(view.mask, 1)
        if not inner.any():
            continue
        pixels += int(inner.sum())
        weight = view.mask.astype(np.float64)[..., None]
        for blur in _BLURS:
            spread, share = (gaussian_filter(x, (0.5 * blur, 0.5 * blur, 0)) for x in (view.image * weight, weight))
            total[blur] += float(np.mean((view.image - spread / np.maximum(share, 1e-6))[inner] ** 2, axis=1).sum())
    return {blur: max(value / max(pixels, 1) - noise**2, 0.0) for blur, value in total.items()}


def _inner(mask: np.ndarray, by: int) -> np.ndarray:
    return binary_erosion(mask, np.ones((2 * by + 1, 2 * by + 1), dtype=bool))
