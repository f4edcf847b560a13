"""The posed body as a Mitsuba mesh that emits a bitmap: primary visibility and texture lookup, with anti-aliasing."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.compare.methods.texture import split_seams


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
        self._poses = capture.poses
        self._frame: int | None = None
        self._background = mi.Color3f(srgb_to_linear(capture.background).tolist())
        mesh = mi.Mesh("body", len(self._source), len(faces), has_vertex_texcoords=True)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = self._vertices(int(capture.poses.frames[0]))
        parameters["faces"] = faces.ravel()
        parameters["vertex_texcoords"] = (uv * [1, -1] + [0, 1]).astype(np.float32).ravel()
        parameters.update()
        self._scene = mi.load_dict({"type": "scene", "body": mesh})
        self._parameters = mi.traverse(self._scene)
        self._key = next(key for key in self._parameters.keys() if key.endswith("vertex_positions"))
        self._bitmap = mi.load_dict(
            {
                "type": "bitmap",
                "bitmap": mi.Bitmap(np.zeros((size, size, 3), dtype=np.float32)),
                "raw": True,
                "wrap_mode": "clamp",
            }
        )
        self._bitmap_parameters = mi.traverse(self._bitmap)

    def set_frame(self, frame: int) -> None:
        """Moves the vertices to `frame`; kernels stay. InputError names the frames there are."""
        if frame != self._frame:
            self._parameters[self._key] = self._vertices(frame)
            self._parameters.update()
            self._frame = frame

    def set_texture(self, linear: mi.TensorXf) -> None:
        """Sets the emitted radiance, (size, size, 3), attached if its gradient is enabled."""
        self._bitmap_parameters["data"] = linear
        self._bitmap_parameters.update()

    def render(
        self, camera: Camera, spp: int, seed: int, rectangle: tuple[int, int, int, int] | None = None
    ) -> mi.TensorXf:
        """Linear radiance over the capture's background, box-filtered: (h, w, 3) of the rectangle x, y, width, height.

        Args:
            camera: a pinhole camera.
            spp: samples a pixel, placed by the `multijitter` sampler.
            seed: of the sampler.
            rectangle: the part of the image to render; everything by default.
        """
        x, y, width, height = rectangle or (0, 0, camera.w, camera.h)
        sampler = mi.load_dict({"type": "multijitter", "sample_count": spp})
        spp = sampler.sample_count()
        count = width * height * spp
        sampler.set_samples_per_wavefront(spp)
        sampler.seed(dr.opaque(mi.UInt32, seed), count)
        pixel = dr.arange(mi.UInt32, count) // spp
        corner = mi.Point2f(pixel % width, pixel // width) + dr.opaque(mi.Point2f, [x, y])
        interaction = self._scene.ray_intersect(camera.rays(corner + sampler.next_2d()))
        radiance = dr.select(interaction.is_valid(), self._bitmap.eval(interaction), self._background)
        return dr.mean(mi.TensorXf(dr.ravel(radiance), (height, width, spp, 3)), axis=2)

    def _vertices(self, frame: int) -> mi.Float:
        return mi.Float(self._poses.vertices[self._poses.index(frame)][self._source].astype(np.float32).ravel())
