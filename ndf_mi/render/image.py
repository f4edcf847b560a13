"""Whole images by quadrature: the pixels whose rays meet the band's box, tile by tile, front to back.

Rays are looked at in rounds, each a part of their samples. What is opaque after a round is left out of those behind:

    L = Σ_k T_k L_k,    T_{k+1} = T_k (1 − opacity_k)

with L_k and opacity_k from round k alone. A ray that is left out at T ≤ `cutoff` would have gained at most T in any channel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.render.quadrature import quadrature
from ndf_mi.render.sampling import box_interval
from ndf_mi.render.strata import VolumeField

LANES = 1 << 19
"""Candidate samples looked at at once. Every tile has as many rays as make this number, so that one set of kernels serves all."""

RECIPE = 2
"""Raised whenever the same field at the same settings gives other pictures than before."""


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
    """Renders images of fields at a fixed number of samples a ray."""

    samples: int = 128
    spp: int = 1
    """Rays a pixel: 1 goes through the centre; more are spread over the pixel by a low-discrepancy sequence and averaged."""
    rounds: int = 4
    """Rounds at most: as many as divide `samples`."""
    cutoff: float = 1e-4
    """Transmittance up to which a ray goes on to the next round; 0 follows every ray to its end."""

    def __call__(self, volume: VolumeField, camera: RaySource, geometry: bool = False) -> Image:
        """Renders `volume` as `camera` sees it; the same every time."""
        pixels = self._pixels(volume, camera)
        out = np.zeros((11 if geometry else 5, camera.h * camera.w), dtype=np.float32)
        with dr.suspend_grad():
            for place in range(self.spp):
                out += self._rounds(volume, camera, pixels, _place(place), geometry) / self.spp
        # What is only there where something is seen is a mean over that, not over the pixel.
        out[4:] /= np.maximum(out[3], 1e-6)
        image = np.moveaxis(out.reshape(-1, camera.h, camera.w), 0, -1)
        return Image(image[..., :3], image[..., 3], image[..., 4],
                     image[..., 5:8] if geometry else None, image[..., 8:11] if geometry else None)

    def _rounds(
        self, volume: VolumeField, camera: RaySource, pixels: np.ndarray, place: tuple[float, float], geometry: bool
    ) -> np.ndarray:
        """Colour, opacity, and times opacity depth and, if asked for, (u, v, l) and normal of one ray a pixel, (5 or 11, h·w)."""
        rounds = max(n for n in range(1, min(self.rounds, self.samples) + 1) if self.samples % n == 0)
        count = self.samples // rounds
        tile = max(LANES // (count * volume.strata), 1)
        out = np.zeros((11 if geometry else 5, camera.h * camera.w), dtype=np.float32)
        transmittance = np.ones(camera.h * camera.w, dtype=np.float32)
        for number in range(rounds):
            for start in range(0, len(pixels), tile):
                chosen = pixels[start : start + tile]
                padded = np.full(tile, chosen[0], dtype=np.uint32)
                padded[: len(chosen)] = chosen
                rays = self._rays(camera, mi.UInt32(padded), place)
                # The padding's rays end where they start, and so cost next to nothing.
                rays.maxt = dr.select(dr.arange(mi.UInt32, tile) < dr.opaque(mi.UInt32, len(chosen)), dr.inf, 0.0)
                seen = quadrature(volume, rays, self.samples, window=(number * count, count), geometry=geometry)
                rows = [*seen.colour, seen.opacity, seen.depth]
                if seen.u is not None and seen.normal is not None:
                    rows += [*seen.u, *seen.normal]
                dr.eval(rows)
                values = np.stack([row.numpy()[: len(chosen)] for row in rows])
                values[4:] *= values[3]
                out[:, chosen] += transmittance[chosen] * values
                transmittance[chosen] *= 1 - values[3]
            if self.cutoff > 0:
                pixels = pixels[transmittance[pixels] > self.cutoff]
        return out

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
