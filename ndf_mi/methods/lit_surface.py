"""The posed body as a diffuse mesh among lights; its texture is the reflectance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.capture.capture import Capture
from ndf_mi.learn.loss import NoisyLoss
from ndf_mi.render.replay import Replay
from ndf_mi.surface.posed_mesh import TRAIN_SPP, PosedMesh, View

DEPTH = {"max_depth": 3, "rr_depth": 4, "hide_emitters": True}
"""Parameters of a path tracer, as synthetic captures are rendered: light reaches the camera by two
reflections at most.
"""


class LitSurface(PosedMesh):
    """The mesh reflects light diffusely on both sides, with smooth normals and interreflection.

    Args:
        capture: whose body, poses and background it has.
        size: texels a side.
        emitters: entries of a scene's dictionary.
    """

    limit = 1.0

    def __init__(self, capture: Capture, size: int, emitters: Mapping[str, Any]) -> None:
        super().__init__(capture, size, diffuse=True, emitters=emitters)
        self._replay = Replay(self.scene, mi.load_dict({"type": "prb", **DEPTH}), self.background)
        self._noisy_loss = NoisyLoss(TRAIN_SPP)
        self._sampler = mi.load_dict({"type": "independent"})

    def backward(self, linear: mi.TensorXf, views: Sequence[View], seeds: Sequence[int]) -> mi.Float:
        """See `PosedMesh.backward`; the error is estimated without bias."""
        # Several passes add to this leaf's gradient; the first one would otherwise free the graph behind it.
        leaf = mi.TensorXf(dr.detach(linear))
        dr.enable_grad(leaf)
        self.set_texture(leaf)
        losses = [self._add_gradient(view, seed, 1 / len(views))
                  for view, seed in zip(views, seeds, strict=True)]
        dr.backward(dr.sum(linear * dr.grad(leaf), axis=None))
        return sum(losses[1:], losses[0]) / len(losses)

    def _add_gradient(self, view: View, seed: int, weight: float) -> mi.Float:
        """Adds the gradient of `weight` times a view's error to the texture's; returns the error."""
        camera, rectangle, truth = view
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
