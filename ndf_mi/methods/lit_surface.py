"""The posed body as a diffuse mesh among lights; its texture is the reflectance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.learn.loss import NoisyLoss
from ndf_mi.methods.lit import LitRenderer
from ndf_mi.render.replay import Replay
from ndf_mi.surface.posed_mesh import PosedMesh
from ndf_mi.surface.texture_fit import TRAIN_SPP, Texels, sampler_seed
from ndf_mi.surface.textured import Rectangle
from ndf_mi.surface.training_views import TrainingViews

MAX_DEPTH = 3
"""Longest path, as synthetic captures are rendered: light reaches the camera by two reflections at most."""


class LitSurface(PosedMesh):
    """The mesh reflects light diffusely on both sides, with smooth normals and interreflection.

    Args:
        capture: whose body, poses and background it has.
        size: texels a side.
        emitters: entries of a scene's dictionary.
    """

    def __init__(self, capture: Capture, size: int, emitters: Mapping[str, Any]) -> None:
        super().__init__(capture, size, diffuse=True, emitters=emitters)
        self._behind = capture.background
        depth = {"max_depth": MAX_DEPTH, "rr_depth": MAX_DEPTH + 1, "hide_emitters": True}
        self._path = mi.load_dict({"type": "path", **depth})
        self._replay = Replay(self.scene, mi.load_dict({"type": "prb", **depth}), self.background)
        self._noisy_loss = NoisyLoss(TRAIN_SPP)
        self._sampler = mi.load_dict({"type": "independent"})

    def add_gradient(self, camera: Camera, rectangle: Rectangle, truth: np.ndarray, seed: int,
                     weight: float) -> mi.Float:
        """Adds the gradient of `weight` times the mean squared error to the texture's; returns the error, one
        number.

        Args:
            camera: a pinhole camera.
            rectangle: the part of the image that is compared.
            truth: (h, w, 3) sRGB in the rectangle.
            seed: of the samples.
            weight: of the error.
        """
        x, y, width, height = rectangle
        index = dr.arange(mi.UInt32, width * height * TRAIN_SPP) // TRAIN_SPP
        corner = mi.Point2f(mi.Float(index % width), mi.Float(index // width)) + dr.opaque(mi.Point2f, [x, y])
        self._sampler.seed(dr.opaque(mi.UInt32, seed), dr.width(index))
        ray = camera.rays(corner + self._sampler.next_2d())
        dr.eval(ray)
        # A ray's position in its pixel and its path must not come from the same random numbers.
        seed += 1 << 30
        radiance = self._replay.radiance(ray, seed)
        error, adjoint = self._noisy_loss(radiance, mi.Color3f(truth.reshape(-1, 3).T))
        self._replay.backward(ray, seed, radiance, adjoint * weight)
        return error

    def lit_picture(self, camera: Camera, pixels: np.ndarray, spp: int,
                    seed: int) -> tuple[np.ndarray, float]:
        """The mesh with the texture and frame set last; arguments and result as for `LitRenderer.render`."""
        return LitRenderer(self.scene, self._path, self._behind, spp).render(camera, pixels, seed)


class ReflectanceFit:
    """A reflectance in [0, 1] under optimisation; arguments and errors as for `TextureFit`, whose schedule
    fits it, too.
    """

    def __init__(self, surface: LitSurface, capture: Capture, size: int, rate: float, seed: int,
                 frames: Sequence[int] | None = None) -> None:
        self._surface = surface
        self._views = TrainingViews(capture, seed, frames)
        self._seed = seed
        self.frames = self._views.frames
        self.texels = Texels(size, self._views.mean_colour(), rate, limit=1.0)

    def set_rate(self, factor: float) -> None:
        """Sets the learning rate to `factor` of its first value."""
        self.texels.set_rate(factor)

    def step(self, number: int) -> float:
        """One update from the next frame's images; returns their mean squared error in sRGB, estimated
        without bias.
        """
        frame, views = self._views.next()
        self._surface.set_frame(frame)
        linear = self.texels.linear
        # Several passes add to this leaf's gradient; the first one would otherwise free the graph behind it.
        leaf = mi.TensorXf(dr.detach(linear))
        dr.enable_grad(leaf)
        self._surface.set_texture(leaf)
        losses = [
            self._surface.add_gradient(camera, rectangle, truth,
                                       sampler_seed(self._seed, number, index, len(views)), 1 / len(views))
            for index, (camera, rectangle, truth) in enumerate(views)
        ]
        loss = sum(losses[1:], losses[0]) / len(losses)
        dr.backward(dr.sum(linear * dr.grad(leaf), axis=None))
        self.texels.step(loss)
        return float(loss[0])
