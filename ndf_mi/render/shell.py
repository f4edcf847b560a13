"""A tight closed mesh around the band of a posed body, so that ray tracing skips the empty space around it."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
from skimage.measure import marching_cubes

from ndf_mi.projection import Surface


def band_shell(surface: Surface, vertices: mi.Float, band: float, cell: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """The boundary of a region that contains every point within `band` of the posed body.

    The distance to the body is sampled on a grid and cut by marching cubes at ``band + √3·cell``. A distance changes by no more than the
    distance between two points: around a point of the band all eight corners of its cell are below that level, and marching
    cubes leaves such a cell whole inside. Where the body is thicker than twice the band, the boundary has
    an inner part too, around the empty inside.

    Args:
        surface: the body's triangles.
        vertices: flat (3·V) posed positions in metres.
        band: the band's half width in metres.
        cell: the grid's spacing in metres.

    Returns:
        vertices (N, 3) float32 and faces (M, 3) uint32, closed, normals pointing out of the region.
    """
    level = band + math.sqrt(3.0) * cell
    reach = level + 2 * cell
    posed = surface.pose(vertices, reach)
    low = posed.bbox.min.numpy().ravel().astype(np.float64) - cell
    high = posed.bbox.max.numpy().ravel().astype(np.float64) + cell
    shape = tuple(int(n) for n in np.ceil((high - low) / cell) + 1)
    distance = np.full(shape, reach, dtype=np.float32)
    flat = distance.reshape(-1)
    with dr.suspend_grad():
        chunk = 1 << 20
        for start in range(0, flat.size, chunk):
            index = np.arange(start, min(start + chunk, flat.size))
            points = low[:, None] + cell * np.stack(np.unravel_index(index, shape))
            x = mi.Point3f(points.astype(np.float32))
            near = posed.near(x)
            found = posed.project(x, near)
            flat[index] = dr.select(near & found.valid, dr.abs(found.l), reach).numpy()
    corners, faces, _, _ = marching_cubes(distance, level, spacing=(cell,) * 3, gradient_direction="descent")
    return (corners + low).astype(np.float32), faces.astype(np.uint32)
