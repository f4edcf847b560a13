"""Pictures of a lit scene over a capture's background, and the noise in them."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.box import BOX_PADDING, padded_box
from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import Camera, box_pixels
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


class LitPerformer:
    """The performer in some light; a base class.

    Args:
        poses: of the performer.
        band: metres around the body in which the performer can be seen; at least `BOX_PADDING` are rendered.
        metadata: of its method and the samples a pixel.
    """

    def __init__(self, poses: Poses, band: float, metadata: dict[str, Any]) -> None:
        self._poses = poses
        self._padding = max(BOX_PADDING, band)
        self._metadata = metadata
        self._noise: float | None = None

    def place(self, camera: Camera, frame: int) -> LitRenderer:
        """The renderer of a scene with the performer at `frame`; raises InputError as `render`."""
        raise NotImplementedError

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the background.

        Raises:
            InputError: the camera is where the performer cannot be seen from.
        """
        renderer = self.place(camera, frame)
        low, high = padded_box(self._poses.vertices[self._poses.index(frame)], self._padding)
        image, self._noise = renderer.render(camera, box_pixels(camera, low, high), frame)
        return image

    def metadata(self) -> dict[str, Any]:
        """That of the method, samples a pixel, and `noise_psnr` of the last picture rendered."""
        if self._noise is None:
            return self._metadata
        return {**self._metadata, "noise_psnr": -10 * math.log10(max(self._noise, 1e-12))}
