"""Whole images by quadrature: the pixels whose rays meet the band's box, tile by tile, front to back.

Rays are marched in rounds, each of which takes a part of their samples. Rays that are opaque after a round
end there:

    L = Σ_k T_k L_k,    T_{k+1} = T_k (1 − opacity_k)

with L_k and opacity_k from round k alone. A ray that ends at T ≤ `cutoff` would have gained at most T in any
channel.
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
"""Candidate samples taken at once. Every tile of an image has as many rays as make this number, or all of
them, so that one set of kernels serves all tiles."""

RECIPE = 2
"""Version of the renderer; it rises whenever the same field and settings give a different image."""


class RaySource(Protocol):
    """A camera: an image size and the rays through pixel coordinates."""

    @property
    def w(self) -> int: ...

    @property
    def h(self) -> int: ...

    def rays(self, pixels: mi.Point2f) -> mi.Ray3f: ...


@dataclass
class Work:
    """The work for an image, counted or estimated, in numbers that do not depend on the machine.

    Attributes:
        rays: rays that met the field's box.
        tiles: launches.
        lanes: candidate lanes in all launches, padding included.
        candidates: candidate samples.
        evaluated: samples that reached the networks.
        launched: lanes that went through the networks, padding included.
    """

    rays: int = 0
    tiles: int = 0
    lanes: int = 0
    candidates: int = 0
    evaluated: float = 0
    launched: float = 0


@dataclass
class Image:
    """An image of a field, in numpy.

    Attributes:
        linear: (h, w, 3) premultiplied linear colour.
        opacity, depth: (h, w); depth in metres along the ray.
        u, normal: (h, w, 3) expected (u, v, l) and normal, zero where nothing is seen; None unless asked for.
        work: what it cost.
    """

    linear: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray
    u: np.ndarray | None
    normal: np.ndarray | None
    work: Work

    def over(self, background: np.ndarray) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1], composited in linear light over an sRGB background (3,)."""
        behind = srgb_to_linear(np.asarray(background, dtype=np.float32))
        picture = linear_to_srgb(self.linear + (1.0 - self.opacity[..., None]) * behind)
        return np.clip(picture, 0.0, 1.0).astype(np.float32)


@dataclass
class ImageRenderer:
    """Renders images of fields with a fixed number of samples a ray."""

    samples: int = 128
    spp: int = 1
    """Rays a pixel. One goes through the centre; more follow a low-discrepancy sequence over the pixel and
    are averaged."""
    rounds: int = 4
    """Largest number of rounds; as many as divide `samples` are used."""
    cutoff: float = 1e-4
    """Early termination: a ray goes on to the next round if its transmittance is above this; 0 follows every
    ray to its end."""
    stratified: bool = False
    """Shift each ray's samples by a random fraction of their spacing, which depends on the pixel alone,
    instead of taking the centres of strata: noise instead of banding."""

    def __post_init__(self) -> None:
        for key in ("samples", "spp", "rounds"):
            if getattr(self, key) < 1:
                raise InputError(key, str(getattr(self, key)), "a whole number above 0")
        if not 0 <= self.cutoff < 1:
            raise InputError("cutoff", f"{self.cutoff:g}", "a transmittance in [0, 1)")

    def __call__(self, volume: VolumeField, camera: RaySource, geometry: bool = False) -> Image:
        """Renders `volume` as `camera` sees it. Deterministic.

        Raises:
            InputError: a ray's result is not finite.
        """
        pixels = self._pixels(volume, camera)
        out = np.zeros((11 if geometry else 5, camera.h * camera.w), dtype=np.float32)
        work = Work(rays=self.spp * len(pixels))
        with dr.suspend_grad():
            for number in range(self.spp):
                out += self._rounds(volume, camera, pixels, number, geometry, work) / self.spp
        # Depth and geometry are means over what is seen, not over the pixel.
        out[4:] /= np.maximum(out[3], 1e-6)
        image = np.moveaxis(out.reshape(-1, camera.h, camera.w), 0, -1)
        return Image(image[..., :3], image[..., 3], image[..., 4],
                     image[..., 5:8] if geometry else None, image[..., 8:11] if geometry else None, work)

    def _rounds(
        self, volume: VolumeField, camera: RaySource, pixels: np.ndarray, ray: int, geometry: bool, work: Work
    ) -> np.ndarray:
        """Ray number `ray` of each pixel: (5 or 11, h·w) colour, opacity, and, multiplied by the opacity,
        depth and, if asked for, (u, v, l) and normal. Adds its counts to `work`."""
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
                # Rays of the padding end where they start, and so cost next to nothing.
                real = dr.arange(mi.UInt32, tile) < dr.opaque(mi.UInt32, len(chosen))
                rays.maxt = dr.select(real, dr.inf, 0.0)
                lanes = count * volume.sample_factor
                jitter = dr.repeat(_shift(index, ray), lanes) if self.stratified else None
                window = (number * count, count)
                seen = quadrature(volume, rays, self.samples, jitter=jitter, window=window, geometry=geometry)
                work.tiles += 1
                work.lanes += tile * lanes
                work.candidates += len(chosen) * lanes
                work.evaluated += seen.evaluated
                work.launched += dr.width(seen.inside)
                rows = [*seen.colour, seen.opacity, seen.depth]
                if seen.u is not None and seen.normal is not None:
                    rows += [*seen.u, *seen.normal]
                dr.eval(rows)
                values = np.stack([row.numpy()[: len(chosen)] for row in rows])
                broken = np.count_nonzero(~np.isfinite(values).all(0))
                if broken:
                    repair = "Half precision ends at 65,504 in hidden layers: leave out `--networks half`."
                    found = f"NaN or infinity along {broken} rays"
                    raise InputError("the field", found, "finite densities and colours", repair)
                values[4:] *= values[3]
                out[:, chosen] += transmittance[chosen] * values
                transmittance[chosen] *= 1 - values[3]
            if self.cutoff > 0:
                pixels = pixels[transmittance[pixels] > self.cutoff]
        return out

    def tiling(self, sample_factor: int, rays: int) -> tuple[int, int, int]:
        """Number of rounds, samples a ray in each, and rays a tile, for `rays` rays that meet the field."""
        rounds = max(n for n in range(1, min(self.rounds, self.samples) + 1) if self.samples % n == 0)
        count = self.samples // rounds
        # Padding costs little a lane, but for few samples of few rays it would be most lanes.
        return rounds, count, min(max(LANES // (count * sample_factor), 1), rounded(rays, QUANTUM))

    def met(self, volume: VolumeField, camera: RaySource) -> int:
        """How many rays of an image meet the field's box, to which its time is proportional. Cheap."""
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
    """Where ray `number` passes through its pixel: the centre first, then the R2 sequence (Roberts 2018),
    whose steps are powers of the inverse of the plastic number."""
    return (0.5 + number * 0.7548776662466927) % 1.0, (0.5 + number * 0.5698402909980532) % 1.0


def _shift(pixel: mi.UInt32, ray: int) -> mi.Float:
    """A random number in [0, 1) for a pixel and its ray. Four rounds, the default, are biased."""
    return mi.sample_tea_float32(pixel, dr.opaque(mi.UInt32, ray), 8)
