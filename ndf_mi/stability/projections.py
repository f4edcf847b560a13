"""Holds a projection, and its derivatives, against the float64 reference."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.projection import Surface
from ndf_mi.stability.ball import charts
from ndf_mi.stability.case import Measured, error
from ndf_mi.stability.closest import closest, inside, on_triangles


@dataclass(frozen=True)
class Shape:
    """A mesh, float32 (V, 3) and (F, 3), with a chart for each triangle unless `uv` (3F, 2) says otherwise; `closed`: has an inside."""

    vertices: np.ndarray
    faces: np.ndarray
    closed: bool = True
    uv: np.ndarray | None = None

    @property
    def texels(self) -> np.ndarray:
        """(F, 3, 2) texture coordinates of the corners."""
        return (charts(len(self.faces))[0] if self.uv is None else self.uv).reshape(-1, 3, 2)

    @property
    def edge(self) -> float:
        """The longest edge, in metres, or the least length that can be told where the mesh is."""
        corner = self.vertices.astype(np.float64)[self.faces]
        longest = float(np.linalg.norm(np.roll(corner, 1, 1) - corner, axis=2).max())
        return max(longest, float(np.spacing(np.abs(self.vertices).max())))

    def surface(self, uv: np.ndarray | None = None) -> Surface:
        """The same for the projection."""
        return Surface(self.faces, self.texels.reshape(-1, 2), charts(len(self.faces))[1], self.vertices)


def judge(at: str, shape: Shape, points: np.ndarray, band: float, sign: np.ndarray | None = None, smooth: bool = True) -> Measured:
    """Projects points (N, 3) and compares distance, closest point and texel, and their derivatives.

    The distance is compared with the least to any triangle; the rest with the closest point of the triangle found, since several may be
    as close. Lengths are relative to the longest edge and the distance; directions to 1 and, where x is close to an edge or a corner,
    to the edge's length over the distance; derivatives of texels to the largest over the points.

    Args:
        band: in metres; every point must be within.
        sign: (N,) of the distance, −1, 1, or 0 where it may be either; by default by the solid angle, where the shape is closed.
        smooth: whether derivatives of texels are compared: not where points are on borders between triangles on purpose.
    """
    x = points.astype(np.float32)
    exact = x.astype(np.float64)
    vertices = shape.vertices.astype(np.float64)
    posed_vertices = mi.Float(np.ascontiguousarray(shape.vertices, np.float32).ravel())
    query = mi.Point3f(np.ascontiguousarray(x.T))
    dr.enable_grad(posed_vertices, query)
    found = shape.surface().pose(posed_vertices, band).project(query)

    dr.backward(dr.sum(found.l), flags=dr.ADFlag.ClearInterior)
    slope, pull = dr.grad(query).numpy().T.astype(np.float64), dr.grad(posed_vertices).numpy().reshape(-1, 3)
    dr.set_grad(query, 0)
    dr.backward(dr.sum(found.uv.x + 2.0 * found.uv.y))
    by_texel = dr.grad(query).numpy().T.astype(np.float64)

    nearest = closest(exact, vertices, shape.faces)
    triangle = found.triangle.numpy().astype(np.int64)
    corners = vertices[shape.faces[triangle]]
    weights = on_triangles(exact, corners)
    offset = np.einsum("nk,nki->ni", weights, exact[:, None] - corners)
    if sign is None:
        sign = np.where(inside(exact, vertices, shape.faces), -1, 1) if shape.closed else np.zeros(len(x), int)
    l = found.l.numpy().astype(np.float64)
    signed = np.where(sign == 0, np.sign(l), sign) * nearest.distance
    length = shape.edge + nearest.distance
    texel = np.einsum("nk,nki->ni", weights, shape.texels[triangle].astype(np.float64))
    spread = np.abs(shape.texels[triangle]).max()
    own = found.barycentric.numpy().T.astype(np.float64)
    ours = np.einsum("nk,nki->ni", own, corners - corners[:, :1])
    theirs = np.einsum("nk,nki->ni", weights, corners - corners[:, :1])
    primal = max(error(l, signed, length), error(ours, theirs, length[:, None]),
                 error(found.uv.numpy().T, texel, spread) if smooth else 0.0,
                 0.0 if bool(dr.all(found.valid)) else np.inf)

    # Which way is up, and how well the offset tells.
    far = nearest.distance > 1e-6 * shape.edge
    reach = np.linalg.norm(offset, axis=1, keepdims=True)
    direction = offset / np.maximum(reach, 1e-300) * np.where(sign == 0, np.sign(l), sign)[:, None]
    scale = 1 + shape.edge / np.maximum(nearest.distance, 1e-300)
    unit = np.abs(np.linalg.norm(slope[far], axis=1) - 1).max(initial=0)
    expected = np.zeros_like(vertices)
    # By the weights found: those of a sliver are hardly determined, only the point is, which has been compared.
    np.add.at(expected, shape.faces[triangle].ravel(), -(own[:, :, None] * slope[:, None]).reshape(-1, 3))
    count = np.bincount(shape.faces[triangle].ravel(), minlength=len(vertices))[:, None]
    gradient = max(error(slope[far], direction[far], scale[far][:, None]), float(unit), error(pull, expected, 1.0 + count))
    if smooth:
        numeric = _texel_slope(exact, corners, shape.texels[triangle], 1e-5 * shape.edge)
        same = np.isfinite(numeric).all(1)
        gradient = max(gradient, error(by_texel[same], numeric[same], np.abs(numeric[same]).max(initial=0)))
    if not np.isfinite(by_texel).all():
        gradient = np.inf
    return Measured(at, primal, gradient)


def _texel_slope(x: np.ndarray, corners: np.ndarray, texels: np.ndarray, step: float) -> np.ndarray:
    """(N, 3) derivatives of u + 2 v of the closest points on given triangles, by central differences; NaN where the closest point goes
    over a border within a few steps."""
    value = np.full(x.shape, np.nan)

    def features(weights: np.ndarray) -> np.ndarray:
        return (weights > 0).astype(int) + 2 * (weights >= 1)

    here = features(on_triangles(x, corners))
    for axis in range(3):
        ends, steady = [], np.ones(len(x), bool)
        for way in (1.0, -1.0):
            moved = x.copy()
            moved[:, axis] += way * step
            weights = on_triangles(moved, corners)
            ends.append(np.einsum("nk,nki->ni", weights, texels.astype(np.float64)) @ [1.0, 2.0])
            moved[:, axis] += way * 9 * step
            for w in (weights, on_triangles(moved, corners)):
                steady &= (features(w) == here).all(1)
        value[steady, axis] = ((ends[0] - ends[1]) / (2 * step))[steady]
    return value
