"""How far from the body a capture needs the volume to reach."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ndf_mi.capture.camera import pixel_rays
from ndf_mi.capture.capture import Capture
from ndf_mi.methods.neural_body.voxels import Stride

FRAMES, PIXELS, SAMPLES = 4, 500, 128
"""Training frames that are looked at, pixels of each of their masks, and points along each ray."""

Placed = tuple[tuple[Stride, ...], Callable[[np.ndarray], np.ndarray]]
"""The voxels of a frame, and the map from (N, 3) points in world space to the finest of them."""


def covered(capture: Capture, placed: Callable[[int], Placed], padding: float) -> list[float]:
    """The share of the masks' pixels whose rays pass voxels of each stride but the first.

    Args:
        capture: with training images.
        placed: the voxels of a frame.
        padding: by which their box is wider than the body, in metres.
    """
    split, rng = capture.splits["train"], np.random.default_rng(0)
    met: list[list[np.ndarray]] = []
    for frame in split.frames[:: -(-len(split.frames) // FRAMES)]:
        strides, to_voxels = placed(frame)
        cells = [_cells(stride) for stride in strides[1:]]
        vertices = capture.poses.vertices[capture.poses.index(frame)]
        radius = np.linalg.norm(np.ptp(vertices, axis=0)) / 2 + padding
        for name in split.cameras:
            camera = capture.cameras[name]
            pixels = rng.permutation(np.flatnonzero(capture.mask(name, frame).ravel()))[:PIXELS]
            origin, direction = pixel_rays(camera, pixels)
            t = np.linalg.norm(camera.position - vertices.mean(0)) + np.linspace(-radius, radius, SAMPLES)
            places = to_voxels((origin.T[:, None] + t[:, None] * direction.T[:, None]).reshape(-1, 3))
            met.append([_any(each, places / 2**number).reshape(-1, SAMPLES).max(1)
                        for number, each in enumerate(cells, start=1)])
    return [float(np.concatenate(each).mean()) for each in zip(*met, strict=True)]


def _cells(stride: Stride) -> np.ndarray:
    """Which cells between eight voxels of the box have one of them; a cell has the place of its first."""
    cells = np.zeros([size + 1 for size in stride.shape], bool)
    for corner in np.ndindex(2, 2, 2):
        cells[tuple((stride.sites + 1 - corner).T)] = True
    return cells


def _any(cells: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(N,) whether points (N, 3), in voxels of the stride, lie in such cells."""
    index = np.floor(places).astype(np.int64) + 1
    inside = ((index >= 0) & (index < cells.shape)).all(-1)
    index[~inside] = 0
    found: np.ndarray = cells[tuple(index.T)] & inside
    return found
