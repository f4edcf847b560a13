"""What the cameras of a frame say of each other's pixels: which rays pass through places that the others see
covered.

Space within reach of the body is carved twice: by cells of a coarse grid, which are left out where two
cameras see background all around them, then by points in the remaining ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, distance_transform_edt

from ndf_mi.capture.camera import Camera

#: Points along each side of a coarse cell.
_FINE = 4
#: Spacing of points, in pixels at the body's distance.
_SPACING = 1.5


def seen_by_others(cameras: Sequence[Camera], masks: Sequence[np.ndarray], vertices: np.ndarray,
                   reach: float) -> list[np.ndarray]:
    """For each camera the pixels whose ray passes, within reach of the body, through a point that every other
    camera's mask holds.

    Points that another camera does not have in its image count as held by it. Rays are sampled about every
    1.5 pixels, and the result is closed by as much. Reach is kept to within 6 pixels.

    Args:
        cameras: pinhole cameras.
        masks: (h, w) bool of each.
        vertices: (V, 3) the posed body.
        reach: metres around the vertices.

    Returns:
        (h, w) bool for each camera; all True for a single camera.
    """
    if len(cameras) < 2:
        return [np.ones(mask.shape, bool) for mask in masks]
    centre = vertices.mean(0)
    pixel = min(-camera.to_camera(centre[None])[0, 2] / camera.fl_x for camera in cameras)
    spacing = _SPACING * max(float(pixel), reach / 64)
    points = _carved(cameras, masks, _cells(vertices, reach, _FINE * spacing), _FINE * spacing)
    offsets = spacing * (np.arange(_FINE) - 0.5 * (_FINE - 1))
    offsets = np.stack(np.meshgrid(offsets, offsets, offsets, indexing="ij"), -1).reshape(-1, 3)
    points = (points[:, None] + offsets.astype(np.float32)).reshape(-1, 3)
    missing = np.zeros(len(points), np.uint8)
    where = np.empty((len(cameras), len(points)), np.int32)
    outside = np.empty((len(cameras), len(points)), bool)
    for index, (camera, mask) in enumerate(zip(cameras, masks, strict=True)):
        where[index] = pixels(camera, points)
        outside[index] = ~np.append(mask.ravel(), True)[where[index]]
        missing += outside[index]
    found = []
    for index, mask in enumerate(masks):
        held = missing - outside[index] == 0
        seen = np.zeros(mask.size + 1, bool)
        seen[where[index][held]] = True
        found.append(binary_closing(np.pad(seen[:-1].reshape(mask.shape), 2), iterations=2)[2:-2, 2:-2])
    return found


def pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(N,) int32 indices, row by row, of the pixels that show (N, 3) points; w·h where none does."""
    matrix = np.asarray(camera.transform, np.float32)
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        column = camera.cx - camera.fl_x * local[:, 0] / local[:, 2]
        row = camera.cy + camera.fl_y * local[:, 1] / local[:, 2]
    inside = (local[:, 2] < 0) & (column >= 0) & (column < camera.w) & (row >= 0) & (row < camera.h)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    return np.where(inside, row.astype(np.int32) * camera.w + column.astype(np.int32), camera.w * camera.h)


def _cells(vertices: np.ndarray, reach: float, size: float) -> np.ndarray:
    """(N, 3) float32 centres of the cells of a grid that lie within about `reach` of the vertices."""
    low = vertices.min(0) - reach - size
    index = np.floor((vertices - low) / size).astype(int)
    occupied = np.zeros(np.ceil((vertices.max(0) + reach + size - low) / size).astype(int), bool)
    occupied[tuple(index.T)] = True
    near = distance_transform_edt(~occupied) * size <= reach + size
    return (low + (np.argwhere(near) + 0.5) * size).astype(np.float32)


def _carved(cameras: Sequence[Camera], masks: Sequence[np.ndarray], cells: np.ndarray,
            size: float) -> np.ndarray:
    """The cells of which at most one camera sees only background."""
    missing = np.zeros(len(cells), np.uint8)
    for camera, mask in zip(cameras, masks, strict=True):
        distance = np.append(distance_transform_edt(~mask).ravel() if mask.any() else np.full(mask.size, 1e9),
                             0.0)
        depth = np.maximum(-camera.to_camera(cells)[:, 2], 1e-3)
        radius = 0.87 * size * camera.fl_x / depth + 1.5
        missing += distance[pixels(camera, cells)] > radius
    return cells[missing <= 1]


def grown(mask: np.ndarray, by: int) -> np.ndarray:
    """The pixels of (h, w) bool and those up to `by` pixels away; eroded by as many if `by` is negative."""
    if by == 0:
        return mask
    square = np.ones((3, 3), bool)
    if by > 0:
        return binary_dilation(mask, square, iterations=by)
    return ~binary_dilation(~mask, square, iterations=-by)
