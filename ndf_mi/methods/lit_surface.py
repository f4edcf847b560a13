"""The posed body as a diffuse mesh among lights; its texture is the reflectance."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.learn.loss import NoisyLoss
from ndf_mi.methods.lit import LitRenderer
from ndf_mi.mitsuba_mesh import make_mesh
from ndf_mi.render.replay import Replay
from ndf_mi.surface.texture_fit import TextureFit
from ndf_mi.surface.textured import Rectangle, TexturedSurface

MAX_DEPTH = 3
"""As the synthetic captures are rendered: light reaches the eye by two reflections at most."""

TRAIN_SPP = 4


class LitSurface(TexturedSurface):
    """As the surface that emits its texture, but with a diffuse BSDF of that reflectance on both sides, smooth normals, and lights.

    Args:
        capture: whose body, poses and background it has.
        size: texels a side.
        lights: entries of a scene's dictionary.
    """

    def __init__(self, capture: Capture, size: int, lights: dict[str, Any]) -> None:
        self._lights = lights
        super().__init__(capture, size)
        self._behind = capture.background
        prb = mi.load_dict({"type": "prb", "max_depth": MAX_DEPTH, "rr_depth": MAX_DEPTH + 1, "hide_emitters": True})
        self._replay = Replay(self._scene, prb, self._background)
        self._noisy = NoisyLoss(TRAIN_SPP)
        self._places = mi.load_dict({"type": "independent"})

    def _make_mesh(self, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> mi.Mesh:
        props = mi.Properties()
        props["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": self._bitmap}})
        return make_mesh("body", vertices, faces, uv=uv, smooth=True, props=props)

    def _make_scene(self, mesh: mi.Mesh) -> mi.Scene:
        return mi.load_dict({"type": "scene", "body": mesh, **self._lights})

    def radiance(self, ray: mi.Ray3f, active: mi.Bool | bool = True) -> mi.Vector4f:
        """Linear radiance along rays, detached, by one path each; and 1 where they meet the body, 0 where they don't."""
        colour = self._replay.radiance(ray, 0)
        return mi.Vector4f(colour.x, colour.y, colour.z, dr.select(self._scene.ray_test(ray, active), mi.Float(1), 0))

    def learn(self, camera: Camera, rectangle: Rectangle, truth: np.ndarray, seed: int, share: float) -> mi.Float:
        """Adds `share` of the gradient of the mean squared error in a rectangle to the texture's; returns the error, one number.

        Args:
            truth: (h, w, 3) sRGB.
        """
        x, y, width, height = rectangle
        index = dr.arange(mi.UInt32, width * height * TRAIN_SPP) // TRAIN_SPP
        corner = mi.Point2f(mi.Float(index % width), mi.Float(index // width)) + dr.opaque(mi.Point2f, [x, y])
        self._places.seed(dr.opaque(mi.UInt32, seed), dr.width(index))
        ray = camera.rays(corner + self._places.next_2d())
        dr.eval(ray)
        # Where in its pixel a ray passes must not be drawn from the numbers that its path is.
        seed += 1 << 30
        radiance = self._replay.radiance(ray, seed)
        error, adjoint = self._noisy(radiance, mi.Color3f(truth.reshape(-1, 3).T))
        self._replay.backward(ray, seed, radiance, adjoint * share)
        return error

    def lit_picture(self, camera: Camera, pixels: np.ndarray, spp: int, seed: int) -> tuple[np.ndarray, float]:
        """As :meth:`ndf_mi.methods.lit.LitRenderer.render`, of the texture and frame set last."""
        path = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": MAX_DEPTH + 1, "hide_emitters": True})
        return LitRenderer(self._scene, path, self._behind, spp).render(camera, pixels, seed)


class ReflectanceFit(TextureFit):
    """A reflectance under optimisation, in [0, 1]; steps, schedules and the loss's units are those of the emitted texture."""

    def step(self) -> float:
        """One update from the next frame's images; returns their mean squared error in sRGB, estimated without bias."""
        assert isinstance(self._surface, LitSurface)
        frame, views = self._views.next()
        self._surface.set_frame(frame)
        linear = srgb_to_linear(self._optimizer["texture"])
        # Several passes add to its gradient, of which the first would take the graph behind it apart.
        shown = mi.TensorXf(dr.detach(linear))
        dr.enable_grad(shown)
        self._surface.set_texture(shown)
        losses = [self._surface.learn(camera, rectangle, truth, self._sampler_seed(index, views), 1 / len(views))
                  for index, (camera, rectangle, truth) in enumerate(views)]
        loss = sum(losses[1:], losses[0]) / len(losses)
        dr.backward(dr.sum(linear * dr.grad(shown), axis=None))
        self._step_texture()
        self._optimizer["texture"] = dr.minimum(dr.detach(self._optimizer["texture"]), 1)
        dr.eval(self._seen, self._optimizer["texture"], loss)
        self.steps += 1
        return float(loss[0])
