"""The posed body as a Mitsuba mesh that emits a bitmap: primary visibility and texture lookup, with anti-aliasing."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.mitsuba_mesh import make_mesh, set_vertices
from ndf_mi.surface.texture import split_seams

Rectangle = tuple[int, int, int, int]


class TexturedSurface:
    """One mesh for all frames of a capture; its vertices move, its topology and texture coordinates stay.

    The bitmap is the surface's emitted radiance, so the radiance of a primary ray is the texel it hits: what Mitsuba's
    `path` finds with `max_depth` 1 on an area emitter. It is evaluated here by `ray_intersect` and the bitmap plugin
    themselves, because then the mesh is no emitter and moving it does not rebuild an emitter's sampling tables, and one
    pass gives both value and gradient. The surface emits on both sides.

    Row 0 of the texture is the top (v = 1), as in an image editor.
    """

    def __init__(self, capture: Capture, size: int) -> None:
        body = capture.body
        self._source, faces, uv = split_seams(body.faces, body.uv, body.uv_faces)
        self._index = mi.UInt32(self._source.astype(np.uint32))
        self._poses = capture.poses
        self._frame: int | None = None
        self._background = mi.Color3f(srgb_to_linear(capture.background).tolist())
        self._bitmap = mi.load_dict(
            {
                "type": "bitmap",
                "bitmap": mi.Bitmap(np.zeros((size, size, 3), dtype=np.float32)),
                "raw": True,
                "wrap_mode": "clamp",
            }
        )
        self._bitmap_parameters = mi.traverse(self._bitmap)
        vertices = self._vertices(int(capture.poses.frames[0]))
        self._scene = self._make_scene(self._make_mesh(vertices, faces, uv * [1, -1] + [0, 1]))
        self._parameters = mi.traverse(self._scene)

    def _make_mesh(self, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> mi.Mesh:
        return make_mesh("body", vertices, faces, uv=uv)

    def _make_scene(self, mesh: mi.Mesh) -> mi.Scene:
        """The scene, with the mesh as ``body``."""
        return mi.load_dict({"type": "scene", "body": mesh})

    def set_frame(self, frame: int) -> None:
        """Moves the vertices to `frame`; kernels stay. InputError names the frames there are."""
        if frame != self._frame:
            self._move(self._vertices(frame))
            self._frame = frame

    def set_vertices(self, vertices: mi.Float) -> None:
        """Moves the body's vertices to these, flat 3·V, metres in world space; attached if their gradient is enabled."""
        self._move(dr.ravel(dr.gather(mi.Point3f, vertices, self._index)))
        self._frame = None

    def set_texture(self, linear: mi.TensorXf) -> None:
        """Sets the emitted radiance, (size, size, 3), attached if its gradient is enabled."""
        self._bitmap_parameters["data"] = linear
        self._bitmap_parameters.update()

    def render(self, camera: Camera, spp: int, seed: int, rectangle: Rectangle | None = None) -> mi.TensorXf:
        """Linear radiance over the capture's background, (h, w, 3); arguments as `layers`."""
        return self.layers(camera, spp, seed, rectangle, coverage=False)

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

    def layers(
        self, camera: Camera, spp: int, seed: int, rectangle: Rectangle | None = None, coverage: bool = True
    ) -> mi.TensorXf:
        """Linear radiance and the share of the pixel that the body covers, box-filtered: (h, w, 4) of the rectangle.

        Args:
            camera: a pinhole camera.
            spp: samples a pixel, placed by the `multijitter` sampler.
            seed: of the sampler.
            rectangle: the part of the image to render, x, y, width, height; everything by default.
            coverage: whether there is a fourth channel.
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
        """Linear radiance along rays, and 1 where they meet the body, 0 where they don't."""
        interaction = self._scene.ray_intersect(ray, active)
        hit = interaction.is_valid()
        colour = dr.select(hit, self._bitmap.eval(interaction, hit), self._background)
        return mi.Vector4f(colour.x, colour.y, colour.z, dr.select(hit, mi.Float(1), 0))

    def occluded(self, ray: mi.Ray3f, active: mi.Bool | bool = True) -> mi.Bool:
        """Whether rays meet the body before their end."""
        return self._scene.ray_test(ray, active)

    def _move(self, vertices: np.ndarray | mi.Float) -> None:
        set_vertices(self._parameters, vertices, "body")
        self._parameters.update()

    def _vertices(self, frame: int) -> np.ndarray:
        return self._poses.vertices[self._poses.index(frame)][self._source]
