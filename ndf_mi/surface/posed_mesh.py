"""The posed body of a capture as a Mitsuba mesh with a bitmap texture."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.mitsuba_mesh import make_mesh, set_vertices
from ndf_mi.surface.texture import split_seams

Rectangle = tuple[int, int, int, int]
"""x, y, width and height of a part of an image, in pixels."""

View = tuple[Camera, Rectangle, np.ndarray]
"""A pinhole camera, a rectangle of its image, and (h, w, 3) float32 sRGB in that rectangle."""

TRAIN_SPP = 4
"""Samples a pixel in training."""


class PosedMesh(ABC):
    """One mesh for all frames: its vertices move, its topology and texture coordinates stay, and so do
    kernels.

    Row 0 of the texture is the top (v = 1), as in an image editor.

    Args:
        capture: whose body, poses and background it has.
        size: texels a side.
        diffuse: whether the texture is the reflectance of a diffuse BSDF on both sides, with smooth normals;
            otherwise only `bitmap` has it.
        emitters: entries of the scene's dictionary, besides the mesh.

    Attributes:
        scene: the Mitsuba scene with the mesh as `body`.
        bitmap: the texture, linear.
        background: linear radiance behind the mesh.
        limit: largest value of a texel in sRGB; None for no limit.
    """

    limit: ClassVar[float | None] = None

    def __init__(self, capture: Capture, size: int, diffuse: bool = False,
                 emitters: Mapping[str, Any] | None = None) -> None:
        body = capture.body
        self._source, faces, uv = split_seams(body.faces, body.uv, body.uv_faces)
        self._index = mi.UInt32(self._source.astype(np.uint32))
        self._poses = capture.poses
        self._frame: int | None = None
        self.background = mi.Color3f(srgb_to_linear(capture.background).tolist())
        empty = mi.Bitmap(np.zeros((size, size, 3), dtype=np.float32))
        self.bitmap = mi.load_dict({"type": "bitmap", "bitmap": empty, "raw": True, "wrap_mode": "clamp"})
        self._bitmap_parameters = mi.traverse(self.bitmap)
        props = mi.Properties()
        if diffuse:
            bsdf = {"type": "diffuse", "reflectance": self.bitmap}
            props["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": bsdf})
        vertices = self._vertices(int(capture.poses.frames[0]))
        mesh = make_mesh("body", vertices, faces, uv=uv * [1, -1] + [0, 1], smooth=diffuse, props=props)
        self.scene = mi.load_dict({"type": "scene", "body": mesh, **(emitters or {})})
        self._parameters = mi.traverse(self.scene)

    def set_frame(self, frame: int) -> None:
        """Moves the vertices to the body's in `frame`. Raises InputError if there is no such frame."""
        if frame != self._frame:
            self._move(self._vertices(frame))
            self._frame = frame

    def set_vertices(self, vertices: mi.Float) -> None:
        """Moves the body's vertices to these, flat 3·V, metres in world space; gradients pass."""
        self._move(dr.ravel(dr.gather(mi.Point3f, vertices, self._index)))
        self._frame = None

    def set_texture(self, linear: mi.TensorXf) -> None:
        """Sets the texture, (size, size, 3) linear; gradients pass."""
        self._bitmap_parameters["data"] = linear
        self._bitmap_parameters.update()

    def hits(self, ray: mi.Ray3f, active: mi.Bool | bool = True) -> mi.Bool:
        """Whether rays meet the mesh before their end."""
        return self.scene.ray_test(ray, active)

    @abstractmethod
    def backward(self, linear: mi.TensorXf, views: Sequence[View], seeds: Sequence[int]) -> mi.Float:
        """Sets the texture and propagates the views' mean squared error in sRGB back to what it was computed
        from; returns the error, one number.

        Args:
            linear: (size, size, 3), attached.
            views: of the frame set last.
            seeds: of the samples, one a view.
        """

    def _move(self, vertices: np.ndarray | mi.Float) -> None:
        set_vertices(self._parameters, vertices, "body")
        self._parameters.update()

    def _vertices(self, frame: int) -> np.ndarray:
        return self._poses.vertices[self._poses.index(frame)][self._source].astype(np.float32)
