"""The posed body as a surface that emits its texture: primary visibility and texture lookup, anti-aliased."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.surface.posed_mesh import TRAIN_SPP, PosedMesh, Rectangle, View


class TexturedSurface(PosedMesh):
    """The mesh emits the texture's radiance on both sides, so a primary ray sees the texel that it hits.

    Mitsuba's `path` computes the same with `max_depth` 1 for an area emitter. Here `ray_intersect` and the
    bitmap plugin compute it: the mesh is no emitter, moving it rebuilds no sampling tables, and one pass
    gives value and gradient.
    """

    def render(self, camera: Camera, spp: int, seed: int, rectangle: Rectangle | None = None) -> mi.TensorXf:
        """(h, w, 3) linear radiance over the capture's background; arguments as for `layers`."""
        return self.layers(camera, spp, seed, rectangle, coverage=False)

    def backward(self, linear: mi.TensorXf, views: Sequence[View], seeds: Sequence[int]) -> mi.Float:
        """See `PosedMesh.backward`."""
        self.set_texture(linear)
        losses = []
        for seed, (camera, rectangle, truth) in zip(seeds, views, strict=True):
            image = linear_to_srgb(self.render(camera, TRAIN_SPP, seed, rectangle))
            losses.append(dr.mean(dr.square(image - mi.TensorXf(truth)), axis=None))
        loss = sum(losses[1:], losses[0]) / len(losses)
        dr.backward(loss)
        return loss.array

    def picture(self, camera: Camera, texture: np.ndarray, spp: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background.

        Args:
            camera: a pinhole camera.
            texture: (size, size, 3) sRGB, at least 0.
            spp: samples a pixel.
        """
        self.set_texture(mi.TensorXf(srgb_to_linear(texture)))
        with dr.suspend_grad():
            image = linear_to_srgb(self.render(camera, spp, seed=0)).numpy()
        return np.clip(image, 0, 1)

    def layers(self, camera: Camera, spp: int, seed: int, rectangle: Rectangle | None = None,
               coverage: bool = True) -> mi.TensorXf:
        """(h, w, 4) linear radiance and the share of each pixel that the body covers, box-filtered.

        Args:
            camera: a pinhole camera.
            spp: samples a pixel, placed by the `multijitter` sampler.
            seed: of the sampler.
            rectangle: the part of the image to render; all of it by default.
            coverage: whether there is the fourth channel.
        """
        x, y, width, height = rectangle or (0, 0, camera.w, camera.h)
        sampler = mi.load_dict({"type": "multijitter", "sample_count": spp})
        spp = sampler.sample_count()
        count = width * height * spp
        sampler.set_samples_per_wavefront(spp)
        sampler.seed(dr.opaque(mi.UInt32, seed), count)
        pixel = dr.arange(mi.UInt32, count) // spp
        corner = mi.Point2f(pixel % width, pixel // width) + dr.opaque(mi.Point2f, [x, y])
        channels = self.radiance(camera.rays(corner + sampler.next_2d()))
        values = channels if coverage else mi.Color3f(*channels[:3])
        return dr.mean(mi.TensorXf(dr.ravel(values), (height, width, spp, len(values))), axis=2)

    def radiance(self, ray: mi.Ray3f, active: mi.Bool | bool = True) -> mi.Vector4f:
        """Linear radiance along rays in three channels; in the fourth 1 where they meet the body and 0
        elsewhere.
        """
        interaction = self.scene.ray_intersect(ray, active)
        hit = interaction.is_valid()
        colour = dr.select(hit, self.bitmap.eval(interaction, hit), self.background)
        return mi.Vector4f(colour.x, colour.y, colour.z, dr.select(hit, mi.Float(1), 0))
