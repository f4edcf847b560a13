"""Whole images by quadrature: the pixels whose rays meet the band's box, tile by tile."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.render.quadrature import VolumeField, Workspace, quadrature
from ndf_mi.render.sampling import box_interval

TILE = 4096
"""Rays rendered at once. Every tile has this many, so that one set of kernels serves all."""


class RaySource(Protocol):
    """A camera: an image size and the rays through pixel coordinates."""

    @property
    def w(self) -> int: ...

    @property
    def h(self) -> int: ...

    def rays(self, pixels: mi.Point2f) -> mi.Ray3f: ...


@dataclass
class Image:
    """An image of a field, numpy. `linear` (h, w, 3) premultiplied linear colour; `opacity` and `depth` (h, w); `u` (h, w, 3) the
    expected (u, v, l) and `normal` (h, w, 3), zero where nothing is seen, or None where not asked for."""

    linear: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray
    u: np.ndarray | None
    normal: np.ndarray | None

    def over(self, background: np.ndarray) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1], composited in linear over an sRGB background (3,)."""
        behind = srgb_to_linear(np.asarray(background, dtype=np.float32))
        return np.clip(linear_to_srgb(self.linear + (1.0 - self.opacity[..., None]) * behind), 0.0, 1.0).astype(np.float32)


@dataclass
class ImageRenderer:
    """Renders images of fields at a fixed number of samples a ray, keeping kernels and array sizes from one to the next."""

    samples: int = 128
    workspace: Workspace = field(default_factory=Workspace)
    spp: int = 1
    """Rays a pixel: 1 goes through the centre; more are spread over the pixel by a low-discrepancy sequence and averaged."""

    def __call__(self, volume: VolumeField, camera: RaySource, geometry: bool = False) -> Image:
        """Renders `volume` as `camera` sees it; the same every time."""
        pixels = self._pixels(volume, camera)
        size = camera.h * camera.w
        channels = 11 if geometry else 5
        out = np.zeros((channels, size), dtype=np.float32)
        with dr.suspend_grad():
            for start in range(0, len(pixels), TILE):
                chosen = pixels[start : start + TILE]
                padded = np.full(TILE, chosen[0], dtype=np.uint32)
                padded[: len(chosen)] = chosen
                for place in range(self.spp):
                    rays = self._rays(camera, mi.UInt32(padded), _place(place))
                    seen = quadrature(volume, rays, self.samples, workspace=self.workspace, geometry=geometry)
                    rows = [*seen.colour, seen.opacity, seen.depth]
                    if seen.u is not None and seen.normal is not None:
                        rows += [*seen.u, *seen.normal]
                    dr.eval(rows)
                    for row, value in zip(out, rows, strict=True):
                        row[chosen] += value.numpy()[: len(chosen)] / self.spp
        image = np.moveaxis(out.reshape(channels, camera.h, camera.w), 0, -1)
        return Image(image[..., :3], image[..., 3], image[..., 4],
                     image[..., 5:8] if geometry else None, image[..., 8:11] if geometry else None)

    @staticmethod
    def _rays(camera: RaySource, index: mi.UInt32, place: tuple[float, float] = (0.5, 0.5)) -> mi.Ray3f:
        width = dr.opaque(mi.UInt32, camera.w)
        y = index // width
        right, down = (dr.opaque(mi.Float, offset) for offset in place)
        return camera.rays(mi.Point2f(mi.Float(index - y * width) + right, mi.Float(y) + down))

    def _pixels(self, volume: VolumeField, camera: RaySource) -> np.ndarray:
        """Indices of the pixels whose rays meet the field's box."""
        rays = self._rays(camera, dr.arange(mi.UInt32, camera.w * camera.h))
        hit, _, _ = box_interval(volume.bbox, rays)
        return np.flatnonzero(hit.numpy()).astype(np.uint32)


def _place(number: int) -> tuple[float, float]:
    """Where in its pixel ray `number` goes: the centre first, then on along the R2 sequence (Roberts 2018), whose steps are powers of
    the inverse of the plastic number."""
    return (0.5 + number * 0.7548776662466927) % 1.0, (0.5 + number * 0.5698402909980532) % 1.0
