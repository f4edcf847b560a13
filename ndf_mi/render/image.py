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
from ndf_mi.errors import InputError
from ndf_mi.render.quadrature import quadrature
from ndf_mi.render.ray_samples import VolumeField
from ndf_mi.render.sampling import QUANTUM, box_interval, rounded

LANES = 1 << 19
"""Candidate samples looked at at once. Every tile of an image has as many rays as make this number, or as there are, so that one set of
kernels serves all."""

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
class Work:
    """What an image took, in numbers that depend on no machine.

    Attributes:
        rays: that met the field's box, over all rays of a pixel.
        tiles: launches, and `lanes` in all of them, padding included.
        candidates: samples looked at.
        evaluated: samples that reached the networks, and `launched` the lanes that went through them, padding included.
    """

    rays: int = 0
    tiles: int = 0
    lanes: int = 0
    candidates: int = 0
    evaluated: int = 0
    launched: int = 0


@dataclass
class Image:
    """An image of a field, numpy. `linear` (h, w, 3) premultiplied linear colour; `opacity` and `depth` (h, w); `u` (h, w, 3) the
    expected (u, v, l) and `normal` (h, w, 3), zero where nothing is seen, or None where not asked for; `work` what it took."""

    linear: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray
    u: np.ndarray | None
    normal: np.ndarray | None
    work: Work

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
    """Early termination: transmittance up to which a ray goes on to the next round; 0 follows every ray to its end."""
    stratified: bool = False
    """Shift each ray's samples by a random part of their distance instead of taking strata's middles: noise in place of bands. The
    shift depends on the pixel alone."""

    def __post_init__(self) -> None:
        for key in ("samples", "spp", "rounds"):
            if getattr(self, key) < 1:
                raise InputError(key, str(getattr(self, key)), "a whole number above 0")
        if not 0 <= self.cutoff < 1:
            raise InputError("cutoff", f"{self.cutoff:g}", "a transmittance in [0, 1)")

    def __call__(self, volume: VolumeField, camera: RaySource, geometry: bool = False) -> Image:
        """Renders `volume` as `camera` sees it; the same every time.

        Raises:
            InputError: a ray has seen something that is not finite.
        """
        pixels = self._pixels(volume, camera)
        out = np.zeros((11 if geometry else 5, camera.h * camera.w), dtype=np.float32)
        work = Work(rays=self.spp * len(pixels))
        with dr.suspend_grad():
            for number in range(self.spp):
                out += self._rounds(volume, camera, pixels, number, geometry, work) / self.spp
        # What is only there where something is seen is a mean over that, not over the pixel.
        out[4:] /= np.maximum(out[3], 1e-6)
        image = np.moveaxis(out.reshape(-1, camera.h, camera.w), 0, -1)
        return Image(image[..., :3], image[..., 3], image[..., 4],
                     image[..., 5:8] if geometry else None, image[..., 8:11] if geometry else None, work)

    def _rounds(
        self, volume: VolumeField, camera: RaySource, pixels: np.ndarray, ray: int, geometry: bool, work: Work
    ) -> np.ndarray:
        """Colour, opacity, and times opacity depth and, if asked for, (u, v, l) and normal of one ray a pixel, (5 or 11, h·w).

        Args:
            ray: which of its rays.
            work: to which it is added.
        """
        rounds, count, tile = self.tiling(volume.sample_factor, len(pixels))
        out = np.zeros((11 if geometry else 5, camera.h * camera.w), dtype=np.float32)
        transmittance = np.ones(camera.h * camera.w, dtype=np.float32)
        for number in range(rounds):
            for start in range(0, len(pixels), tile):
                chosen = pixels[start : start + tile]
                padded = np.full(tile, chosen[0], dtype=np.uint32)
                padded[: len(chosen)] = chosen
                index = mi.UInt32(padded)
                rays = self._rays(camera, index, _place(ray))
                # The padding's rays end where they start, and so cost next to nothing.
                rays.maxt = dr.select(dr.arange(mi.UInt32, tile) < dr.opaque(mi.UInt32, len(chosen)), dr.inf, 0.0)
                jitter = dr.repeat(_shift(index, ray), count * volume.sample_factor) if self.stratified else None
                seen = quadrature(volume, rays, self.samples, jitter=jitter, window=(number * count, count), geometry=geometry)
                work.tiles += 1
                work.lanes += tile * count * volume.sample_factor
                work.candidates += len(chosen) * count * volume.sample_factor
                work.evaluated += seen.evaluated
                work.launched += dr.width(seen.inside)
                rows = [*seen.colour, seen.opacity, seen.depth]
                if seen.u is not None and seen.normal is not None:
                    rows += [*seen.u, *seen.normal]
                dr.eval(rows)
                values = np.stack([row.numpy()[: len(chosen)] for row in rows])
                broken = np.count_nonzero(~np.isfinite(values).all(0))
                if broken:
                    raise InputError("the field", f"NaN or infinity along {broken} rays", "finite densities and colours",
                                     "In half precision hidden values end at 65,504: without `--networks half` they may be larger.")
                values[4:] *= values[3]
                out[:, chosen] += transmittance[chosen] * values
                transmittance[chosen] *= 1 - values[3]
            if self.cutoff > 0:
                pixels = pixels[transmittance[pixels] > self.cutoff]
        return out

    def tiling(self, sample_factor: int, rays: int) -> tuple[int, int, int]:
        """Rounds, samples a ray of each, and rays that are looked at at once, where so many meet a field with that `sample_factor`."""
        rounds = max(n for n in range(1, min(self.rounds, self.samples) + 1) if self.samples % n == 0)
        count = self.samples // rounds
        # Padding costs little a lane, but where few samples of few rays are wanted it would be most lanes.
        return rounds, count, min(max(LANES // (count * sample_factor), 1), rounded(rays, QUANTUM))

    def met(self, volume: VolumeField, camera: RaySource) -> int:
        """How many rays of an image meet the field's box: what its time is proportional to. Cheap."""
        return self.spp * len(self._pixels(volume, camera))

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


def _shift(pixel: mi.UInt32, ray: int) -> mi.Float:
    """A number in [0, 1) for a pixel and the number of its ray. The default of four rounds is biased over neighbouring pixels."""
    return mi.sample_tea_float32(pixel, dr.opaque(mi.UInt32, ray), 8)
