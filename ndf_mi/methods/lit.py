"""Pictures of a lit scene over a capture's background, and the noise in them."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.render.sampling import rounded

LANES = 1 << 16
"""Paths traced at once, at most."""

PIXELS = 256
"""The number of pixels of a launch is one of few multiples of this: 1, 3/2, 2, 3, 4 and so on."""


class LitRenderer:
    """Renders a scene with one of Mitsuba's integrators and a box filter; rays that meet nothing see the
    background.

    Args:
        scene: performer and lights.
        integrator: one with `hide_emitters`.
        background: (3,) sRGB.
        spp: samples a pixel, an even number.
    """

    def __init__(self, scene: mi.Scene, integrator: Any, background: np.ndarray, spp: int) -> None:
        self._scene = scene
        self._integrator = integrator
        self._background = np.asarray(srgb_to_linear(np.asarray(background, dtype=np.float64)))
        self._spp = spp
        self._sampler = mi.load_dict({"type": "independent"})

    def render(self, camera: Camera, pixels: np.ndarray, seed: int) -> tuple[np.ndarray, float]:
        """Renders one picture.

        Args:
            camera: a pinhole camera.
            pixels: (h, w) bool, those that may show the performer.
            seed: of the samples.

        Returns:
            (h, w, 3) float32 sRGB in [0, 1], and the mean squared error in sRGB that noise makes in `pixels`.
            It is estimated from the difference of two pictures with half of the samples each.
        """
        where = np.flatnonzero(pixels)
        first, second = (self._half(camera, where, 2 * seed + half) for half in range(2))
        noise = float(np.mean(np.square(_encode(first) - _encode(second)))) / 4
        image = np.broadcast_to(self._background, (camera.h * camera.w, 3)).copy()
        image[where] = (first + second) / 2
        return _encode(image).reshape(camera.h, camera.w, 3).astype(np.float32), noise

    def _half(self, camera: Camera, where: np.ndarray, seed: int) -> np.ndarray:
        """(P, 3) linear means over half of the samples."""
        samples = self._spp // 2
        # A few launch sizes serve all cameras, and small pictures are not padded to the size of large ones.
        step = min(max(LANES // samples, 1), rounded(max(len(where), 1), PIXELS))
        out = np.zeros((len(where), 3))
        for start in range(0, len(where), step):
            some = where[start : start + step]
            tile = self._tile(camera, np.resize(some, step), samples, seed * 8191 + start)
            out[start : start + step] = tile[: len(some)]
        return out

    def _tile(self, camera: Camera, pixels: np.ndarray, samples: int, seed: int) -> np.ndarray:
        count = len(pixels) * samples
        self._sampler.seed(dr.opaque(mi.UInt32, seed % 2**32), count)
        index = dr.arange(mi.UInt32, count) // samples
        pixel = dr.gather(mi.UInt32, mi.UInt32(pixels.astype(np.uint32)), index)
        row = pixel // dr.opaque(mi.UInt32, camera.w)
        corner = mi.Point2f(mi.Float(pixel - row * dr.opaque(mi.UInt32, camera.w)), mi.Float(row))
        ray = mi.RayDifferential3f(camera.rays(corner + self._sampler.next_2d()))
        with dr.suspend_grad():
            found, hit, _ = self._integrator.sample(self._scene, self._sampler, ray)
            colour = dr.select(hit, mi.Color3f(found), mi.Color3f(self._background.tolist()))
            # One launch for all channels: each block sum would trace the paths again.
            dr.eval(colour)
            return np.stack([dr.block_sum(channel, samples).numpy() for channel in colour], axis=1) / samples


def _encode(linear: np.ndarray) -> np.ndarray:
    return np.clip(linear_to_srgb(np.maximum(linear, 0)), 0, 1)


def noise_psnr(noise: float | None) -> dict[str, float]:
    """The metadata `noise_psnr` from the mean squared error that noise makes in a picture; empty for None."""
    return {} if noise is None else {"noise_psnr": -10 * math.log10(max(noise, 1e-12))}
