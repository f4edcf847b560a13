"""Silhouettes of posed bodies in a camera's image, by ray casting."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.mitsuba_mesh import make_mesh, set_vertices


class Silhouettes:
    """Draws which pixels show a body. Needs a Mitsuba variant.

    Args:
        faces: (F, 3) the body's triangles.
        vertices: their number, V.
    """

    def __init__(self, faces: np.ndarray, vertices: int) -> None:
        self._scene = mi.load_dict({"type": "scene",
                                    "body": make_mesh("body", np.zeros((vertices, 3)), faces)})
        self._parameters = mi.traverse(self._scene)

    def pose(self, vertices: np.ndarray) -> None:
        """Moves the body to (V, 3) world vertices."""
        set_vertices(self._parameters, vertices, "body")
        self._parameters.update()

    def draw(self, camera: Camera) -> np.ndarray:
        """(h, w) bool: the ray through the pixel's centre hits the body. `camera` has no distortion."""
        index = dr.arange(mi.UInt32, camera.w * camera.h)
        width = dr.opaque(mi.UInt32, camera.w)
        row = index // width
        ray = camera.rays(mi.Point2f(mi.Float(index - row * width), mi.Float(row)) + 0.5)
        return np.array(self._scene.ray_test(ray)).reshape(camera.h, camera.w)
