"""Which primitives the rays of cameras meet, by projecting the primitives onto the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera, pixel_rays
from ndf_mi.methods.gaussians.compositing import EXTENT, Hits, Posed, meet
from ndf_mi.render.sampling import rounded

MIN_TRANSMITTANCE = 0.01
"""A ray ends where its transmittance is at most this, as in `volprim_rf_basic`."""

QUANTUM = 1 << 14
"""Lists have this length or that of a few multiples: each length means new kernels."""


@dataclass(frozen=True)
class Rectangle:
    """A part of a pinhole camera's image, in pixels, and the rays through the centres of its pixels, row by
    row."""

    camera: Camera
    x: int
    y: int
    width: int
    height: int

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Origins and unit directions, (3, width·height) float64, world space."""
        rows, columns = np.mgrid[self.y : self.y + self.height, self.x : self.x + self.width]
        return pixel_rays(self.camera, (rows * self.camera.w + columns).ravel())


def find_hits(posed: Posed, rectangles: Sequence[Rectangle], origin: mi.Point3f, direction: mi.Vector3f
              ) -> Hits:
    """The primitives that rays meet before their transmittance ends; detached.

    A primitive that reaches behind the camera's image plane is not seen.

    Args:
        posed: N primitives.
        rectangles: where the rays go through.
        origin, direction: the rays of all rectangles, one after the other.
    """
    with dr.suspend_grad():
        primitive, ray = _candidates(posed, rectangles)
        count = len(primitive)
        size = rounded(max(count, 1), QUANTUM)
        primitives, rays = (mi.UInt32(_padded(values, size)) for values in (primitive, ray))
        active = dr.arange(mi.UInt32, size) < dr.opaque(mi.UInt32, count)
        whitening = posed.whitening()
        dr.eval(whitening)
        alphas, entries = meet(posed, whitening, primitives, dr.gather(mi.Point3f, origin, rays),
                               dr.gather(mi.Vector3f, direction, rays), active)
        dr.eval(alphas, entries)
    alpha, entry = alphas.numpy()[:count], entries.numpy()[:count]
    met = np.flatnonzero(entry > 0)
    met = met[_order(ray[met], entry[met])]
    primitive, ray, alpha = primitive[met], ray[met], alpha[met]
    depth = np.cumsum(-np.log1p(-alpha.astype(np.float64)))
    first = _first(ray)
    before = np.where(first > 0, depth[first - 1], 0.0) if len(first) else depth
    kept = np.flatnonzero(depth + np.log1p(-alpha.astype(np.float64)) - before
                          < -np.log(MIN_TRANSMITTANCE) + 1e-6)
    primitive, ray = primitive[kept], ray[kept]
    size = rounded(max(len(kept), 1), QUANTUM)
    return Hits(primitive=mi.UInt32(_padded(primitive, size)), ray=mi.UInt32(_padded(ray, size)),
                first=mi.UInt32(_padded(_first(ray), size)),
                real=dr.arange(mi.UInt32, size) < dr.opaque(mi.UInt32, len(kept)))


def _candidates(posed: Posed, rectangles: Sequence[Rectangle]) -> tuple[np.ndarray, np.ndarray]:
    """Indices of primitives and rays: each primitive with the pixels of the rectangle around its image."""
    centre, scale = (np.array(dr.detach(values), np.float64) for values in (posed.centre, posed.scale))
    rotation = np.array(dr.quat_to_matrix(mi.Matrix3f, dr.detach(posed.rotation)), np.float64)
    # (N, 3, 3): the columns are the half axes of the ellipsoids.
    axes = EXTENT * np.moveaxis(rotation, -1, 0) * scale.T[:, None]
    primitives, rays, base = [], [], 0
    for part in rectangles:
        low, high = _bounds(part, centre.T, axes)
        width, height = (high - low).clip(0).T
        count = width * height
        index = np.repeat(np.arange(len(count)), count)
        place = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
        row, column = np.divmod(place, np.repeat(width, count))
        primitives.append(index)
        rays.append(base + (low[index, 1] + row) * part.width + low[index, 0] + column)
        base += part.width * part.height
    return np.concatenate(primitives).astype(np.uint32), np.concatenate(rays).astype(np.uint32)


def _bounds(part: Rectangle, centre: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) int each, column and row relative to the rectangle: the first pixel whose centre can lie in the
    ellipsoid's image, and the one after the last. Empty where it is not wholly in front of the camera.

    The image of an ellipsoid with half axes A around c is the conic whose dual is K (A Aᵀ − c cᵀ) Kᵀ = G; its
    tangents at constant x are (G_xz ± √(G_xz² − G_xx G_zz)) / G_zz.
    """
    camera = part.camera
    turn = np.asarray(camera.transform, np.float64)[:3, :3] * [1, -1, -1]
    c = (centre - camera.position) @ turn
    a = np.einsum("ij,nik->njk", turn, axes)
    k = np.array([[camera.fl_x, 0, camera.cx], [0, camera.fl_y, camera.cy], [0, 0, 1]])
    kc, ka = c @ k.T, k @ a
    g = np.einsum("nij,nkj->nik", ka, ka) - kc[:, :, None] * kc[:, None, :]
    zz = np.minimum(g[:, 2, 2], -1e-12)
    across = g[:, :2, 2]
    root = np.sqrt(np.maximum(across**2 - g[:, [0, 1], [0, 1]] * zz[:, None], 0))
    visible = ((g[:, 2, 2] < 0) & (c[:, 2] > 0))[:, None]
    corner = np.array([part.x, part.y])
    size = np.array([part.width, part.height])
    low, high = ((across + sign * root) / zz[:, None] - corner for sign in (1, -1))
    low = np.ceil(np.clip(low, -1, size + 1) - 0.5).clip(0)
    high = np.floor(np.clip(high, -1, size + 1) - 0.5).clip(None, size - 1) + 1
    return np.where(visible, low, 0).astype(int), np.where(visible, high, 0).astype(int)


def _order(ray: np.ndarray, entry: np.ndarray) -> np.ndarray:
    """Indices that sort by ray, then by entry, which is above 0: digit by digit from the least significant
    one, since NumPy sorts numbers of 16 bits in linear time. The bits of positive floats are in their order.
    """
    bits = entry.astype(np.float32).view(np.uint32)
    digits = [bits, bits >> 16, ray, *([ray >> 16] if len(ray) and ray.max() >= 1 << 16 else [])]
    order = np.arange(len(ray))
    for digit in digits:
        order = order[np.argsort(digit.astype(np.uint16)[order], kind="stable")]
    return order


def _first(ray: np.ndarray) -> np.ndarray:
    """For each entry of a sorted array, the index of the first that equals it."""
    starts = np.flatnonzero(np.diff(ray, prepend=-1 if not len(ray) else int(ray[0]) - 1))
    return np.repeat(starts, np.diff(np.append(starts, len(ray))))


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.pad(values, (0, size - len(values))).astype(np.uint32)
