"""The cameras of a capture stage: a ring at about the height of the chest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ndf_mi.capture.camera import Camera, look_at

_RADIUS = 3.2
_HEIGHT = 1.15
#: Metres around the body's vertices that must be visible too: clothes and hair.
_CLOTHES = 0.07
#: Fraction of the image that stays free at each side.
_FREE = 0.04


def camera_ring(
    count: int, pixels: int, vertices: np.ndarray, seed: int, worn: np.ndarray | None = None
) -> dict[str, Camera]:
    """``count`` cameras, evenly around the y axis, that always see the whole performer.

    Heights, distances and aims vary a little with ``seed``. Each camera has the largest focal length at which
    the clothed body, around its posed ``vertices``, (T, V, 3) metres, stays in the image, and so do the
    points ``worn``, (N, 3), of wide clothes.
    """
    random = np.random.default_rng(seed)
    # Some vertices, moved by the thickness of clothes.
    shifts = np.concatenate([np.eye(3), -np.eye(3)]) * _CLOTHES
    points = (vertices[:, ::16].reshape(-1, 1, 3) + shifts).reshape(-1, 3)
    if worn is not None:
        points = np.concatenate([points, worn])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    cameras = {}
    for i in range(count):
        angle = 2 * np.pi * i / count
        radius = _RADIUS + random.uniform(-0.1, 0.1)
        position = np.array([radius * np.sin(angle), _HEIGHT + random.uniform(-0.2, 0.25),
                             radius * np.cos(angle)])
        target = np.array([0.0, middle[1], 0.0]) + random.uniform(-0.02, 0.02, 3)
        camera = Camera(f"cam{i:02d}", pixels, pixels, 1.0, 1.0, pixels / 2, pixels / 2,
                        look_at(position, target))
        reach = np.abs(camera.project(points) - pixels / 2).max()
        focal = pixels * (0.5 - _FREE) / reach
        cameras[camera.name] = replace(camera, fl_x=focal, fl_y=focal)
    return cameras


def evenly(names: Sequence[str], count: int) -> tuple[str, ...]:
    """``count`` of ``names``, evenly spaced, from the first on."""
    return tuple(names[round(i * len(names) / count)] for i in range(count))
