"""The textured mesh for relighting: a diffuse reflectance, optimised under one light and shown under any."""

from __future__ import annotations

import hashlib
from typing import Any

import mitsuba as mi
import numpy as np

from ndf_mi.body.box import BOX_PADDING, padded_box
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.pixels import box_pixels
from ndf_mi.colour import srgb_to_linear
from ndf_mi.methods.lit_surface import LitSurface, ReflectanceFit
from ndf_mi.methods.mesh import TexturedMesh
from ndf_mi.render.lights import lights as lights_of
from ndf_mi.surface.texture_fit import Progress, best_rate


class LitMesh(TexturedMesh):
    """Baseline: the posed body with a diffuse texture, path traced among the capture's lights with interreflection, as the truth is.

    Args:
        capture: whose body, poses and background it has, and whose `train` split it learns from.
        size: texels a side.
        rate: Adam's learning rate; None finds the best of a sweep when `fit` is called.
        lights: entries of a scene's dictionary; None takes the capture's own.
        label: of the light, for the fingerprint.
        spp: samples a pixel of the pictures.

    Attributes:
        noise: of the images rendered, the share of their mean squared error that is noise, one number an image.
    """

    def __init__(
        self, capture: Capture, size: int = 256, rate: float | None = None, lights: dict[str, Any] | None = None, label: str = "",
        spp: int = 256,
    ) -> None:
        super().__init__(capture, size, rate)
        self._surface = self._lit = LitSurface(capture, size, lights_of(capture.known_lighting()) if lights is None else lights)
        self._poses = capture.poses
        self._label = label
        self._spp = spp
        self.noise: list[float] = []

    def fit(self, capture: Capture, seconds: float | None = None, seed: int = 0, progress: Progress | None = None) -> None:
        """As the emitting mesh is fitted: the best rate of a sweep, random frames, Adam, until the loss stops falling."""
        facts = self._facts
        if not facts.rate:
            facts.rate, facts.sweep, facts.sweep_seconds = best_rate(self._surface, capture, facts.size, seed, ReflectanceFit)
        self._train(ReflectanceFit(self._surface, capture, facts.size, facts.rate, seed), capture, seconds, seed, progress)

    def under(self, capture: Capture, lights: dict[str, Any], label: str, spp: int) -> LitMesh:
        """The same mesh among other lights, with other samples a pixel."""
        other = LitMesh(capture, self._facts.size, None, lights, label, spp)
        other._facts, other.texture, other.seen = self._facts, self.texture, self.seen
        return other

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background."""
        self._pose(frame)
        self._surface.set_texture(mi.TensorXf(srgb_to_linear(self.texture)))
        low, high = padded_box(self._poses.vertices[self._poses.index(frame)], BOX_PADDING)
        image, noise = self._lit.picture(camera, box_pixels(camera, low, high), self._spp, frame)
        self.noise.append(noise)
        return image

    def fingerprint(self) -> str:
        """SHA-256 (hex) over what is rendered and how: equal ones give equal images."""
        return hashlib.sha256(f"{self._label} {self._spp} {super().fingerprint()}".encode()).hexdigest()
