"""Pixels and their rays in numpy, float64: for sampling and masks, where no kernel is needed."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.camera import Camera


def pixel_rays(camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions, (3, N) float64, of the rays through pixel centres.

    Args:
        camera: a pinhole camera.
        pixels: (N,) pixel indices, numbered row by row.
    """
    y, x = np.divmod(pixels.astype(np.int64), camera.w)
    local = np.stack([(x + 0.5 - camera.cx) / camera.fl_x, (camera.cy - y - 0.5) / camera.fl_y,
                      -np.ones(len(pixels))])
    direction = np.asarray(camera.transform, dtype=np.float64)[:3, :3] @ local
    origin = np.broadcast_to(camera.position[:, None], direction.shape)
    return origin, direction / np.linalg.norm(direction, axis=0)


def box_pixels(camera: Camera, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels whose ray meets the box [low, high] in front of the camera."""
    origin, direction = pixel_rays(camera, np.arange(camera.w * camera.h))
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low[:, None] - origin) / direction, (high[:, None] - origin) / direction
    near, far = np.fmin(a, b).max(0), np.fmax(a, b).min(0)
    return (far > np.maximum(near, 0)).reshape(camera.h, camera.w)
