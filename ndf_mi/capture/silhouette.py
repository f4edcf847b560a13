"""Silhouettes of posed bodies in a camera's image, by ray casting, and how well masks agree with them."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.mitsuba_mesh import make_mesh, set_vertices


class Silhouettes:
    """Casts rays of cameras at a body. Needs a Mitsuba variant.

    Args:
        faces: (F, 3) the body's triangles.
        vertices: their number, V. They are all at the origin until `pose` is called.
    """

    def __init__(self, faces: np.ndarray, vertices: int) -> None:
        self._vertices = np.zeros((vertices, 3))
        mesh = make_mesh("body", self._vertices, faces.astype(np.uint32))
        self._scene = mi.load_dict({"type": "scene", "body": mesh})
        self._parameters = mi.traverse(self._scene)

    def pose(self, vertices: np.ndarray) -> None:
        """Moves the body to (V, 3) world vertices."""
        set_vertices(self._parameters, vertices.astype(np.float32), "body")
        self._parameters.update()
        self._vertices = vertices

    def hits(self, camera: Camera, pixels: np.ndarray, distance: np.ndarray | None = None) -> np.ndarray:
        """(N,) bool, whether the rays through these (N, 2) pixel coordinates hit the body.

        Args:
            camera: without distortion.
            pixels: (0.5, 0.5) is the centre of the top left one.
            distance: (N,) metres at which each ray ends; by default nowhere.
        """
        x, y = (mi.Float(np.ascontiguousarray(column, dtype=np.float32)) for column in pixels.T)
        ray = camera.rays(mi.Point2f(x, y))
        if distance is not None:
            ray.maxt = mi.Float(distance.astype(np.float32))
        with dr.suspend_grad():
            return np.asarray(self._scene.ray_test(ray).numpy(), dtype=bool)

    def draw(self, camera: Camera) -> np.ndarray:
        """(h, w) bool: the ray through the pixel's centre hits the body. `camera` has no distortion."""
        whole = np.zeros((camera.h, camera.w), dtype=bool)
        points = camera.project(self._vertices)
        low, high = np.zeros(2, dtype=int), np.array([camera.w, camera.h])
        if np.isfinite(points).all():  # otherwise some are behind the camera, and may be seen anywhere
            low, high = (np.clip(corner, 0, high).astype(int)
                         for corner in (np.floor(points.min(axis=0)), np.ceil(points.max(axis=0))))
        part = np.s_[low[1] : high[1], low[0] : high[0]]
        y, x = (values.ravel() + 0.5 for values in np.mgrid[part])
        if len(x):
            whole[part] = self.hits(camera, np.stack([x, y], axis=1)).reshape(whole[part].shape)
        return whole


def agreement(silhouettes: Sequence[np.ndarray], masks: Sequence[np.ndarray]) -> float:
    """The mean over the images of the intersection over union of silhouette and mask, in [0, 1].

    Args:
        silhouettes, masks: (h, w) bool each; an image in which both are empty counts as 1.
    """
    shares = []
    for silhouette, mask in zip(silhouettes, masks, strict=True):
        union = np.count_nonzero(silhouette | mask)
        shares.append(np.count_nonzero(silhouette & mask) / union if union else 1.0)
    return float(np.mean(shares))
