"""Holds a projection, and its derivatives, against the float64 reference."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.projection import PosedSurface, Surface
from ndf_mi.stability.ball import charts
from ndf_mi.stability.case import PROMISE, Measured, error
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
    as close. Lengths are relative to the longest edge and the distance. ∂l/∂x is compared with the triangle's normal wherever its inside
    is closest, at any distance; with the offset's direction where an edge or a corner is, relative to the edge's length over the distance;
    and on these, where an offset has no direction, with the normals and pseudonormals that meet there. Texels, and derivatives of texels to
    the largest over the points, are compared but on slivers.

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
    found = PosedSurface(shape.surface(), posed_vertices, band).project(query)

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
    sign = np.where(sign == 0, np.nan_to_num(np.sign(l)), sign)
    length = shape.edge + nearest.distance
    normals = Normals(vertices, shape.faces)
    sine, reach = normals.sine[triangle], nearest.distance / np.maximum(normals.longest[triangle], 1e-300)

    texel = np.einsum("nk,nki->ni", weights, shape.texels[triangle].astype(np.float64))
    wide = sine > 0.01
    own = found.barycentric.numpy().T.astype(np.float64)
    ours = np.einsum("nk,nki->ni", own, corners - corners[:, :1])
    theirs = np.einsum("nk,nki->ni", weights, corners - corners[:, :1])
    primal = max(error(l, sign * nearest.distance, length), error(ours, theirs, length[:, None]),
                 error(found.uv.numpy().T[wide], texel[wide], np.abs(shape.texels[triangle]).max() * (1 + reach[wide, None])),
                 0.0 if bool(dr.all(found.valid)) else np.inf)

    # Which way is up: on a face, past an edge or a corner, and on these.
    flat = weights.min(1) * sine > 1e-5 * (1 + reach)
    past = ~flat & (nearest.distance > 2e-6 * shape.edge)
    at_border = ~flat & (reach < 5e-7) & (sine > 1e-5)
    expected, scale = np.nan_to_num(slope), np.ones(len(x))
    expected[flat], scale[flat] = normals.face[triangle[flat]], np.where(sine[flat] > 0.1, 1.0, 1 / sine[flat])
    expected[past] = (sign[:, None] * offset / np.maximum(np.linalg.norm(offset, axis=1), 1e-300)[:, None])[past]
    # An offset of hardly any length may be off by half of it, but not turn round.
    scale[past] = np.minimum(1 + shape.edge / nearest.distance[past], 0.5 / PROMISE)
    known = flat | past
    unit = np.abs(np.linalg.norm(slope[known], axis=1) - 1).max(initial=0)
    off = normals.off(slope[at_border], triangle[at_border], weights[at_border])
    by_vertex = np.zeros_like(vertices)
    # By the weights found: those of a sliver are hardly determined, only the point is, which has been compared.
    np.add.at(by_vertex, shape.faces[triangle].ravel(), -(own[:, :, None] * expected[:, None]).reshape(-1, 3))
    terms = np.bincount(shape.faces[triangle].ravel(), np.repeat(scale, 3), minlength=len(vertices))[:, None]
    gradient = max(error(slope, expected, scale[:, None]), float(unit), float(off), error(pull, by_vertex, 1.0 + terms))
    if smooth:
        numeric = _texel_slope(exact, corners, shape.texels[triangle], 1e-5 * shape.edge)
        same = np.isfinite(numeric).all(1)
        gradient = max(gradient, error(by_texel[same], numeric[same], np.abs(numeric[same]).max(initial=0)))
    if not np.isfinite(by_texel).all():
        gradient = np.inf
    return Measured(at, primal, gradient)


class Normals:
    """Unit normals of a mesh's faces, edges and corners in float64: an edge's is that of its faces' sum, a corner's of the sum of those
    around it, weighted by their angles there (Bærentzen and Aanæs 2005).

    Attributes:
        face: (F, 3), zero where there is no area.
        edge: (F, 3, 3), of the edges from corner k to corner k + 1.
        corner: (V, 3).
        longest: (F,) edges' lengths.
        sine: (F,) the least height over the longest edge: about the sine of the least angle.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._faces = faces
        corner = vertices[faces]
        sides = np.roll(corner, -1, 1) - corner
        lengths = np.linalg.norm(sides, axis=2)
        cross = np.cross(sides[:, 0], -sides[:, 2])
        area = np.linalg.norm(cross, axis=1)
        self.longest = lengths.max(1)
        self.sine = area / np.maximum(self.longest**2, 1e-300)
        self.face = _unit(cross)
        ends = [list(zip(row.tolist(), np.roll(row, -1).tolist(), strict=True)) for row in faces]
        owner = {pair: face for face, pairs in enumerate(ends) for pair in pairs}
        across = np.array([[owner.get((b, a), face) for a, b in pairs] for face, pairs in enumerate(ends)])
        self.edge = _unit(self.face[:, None] + self.face[across])
        total = np.zeros_like(vertices)
        for k in range(3):
            out, back = sides[:, k], -sides[:, k - 1]
            angle = np.arctan2(np.linalg.norm(np.cross(out, back), axis=1), np.einsum("fi,fi->f", out, back))
            np.add.at(total, faces[:, k], angle[:, None] * self.face)
        self.corner = _unit(total)

    def off(self, slope: np.ndarray, triangle: np.ndarray, weights: np.ndarray) -> float:
        """How far slopes (N, 3), at points on a border of their triangle, are from the nearest of its normal and those of the edges and the
        corner that the weights (N, 3) are at."""
        found = np.abs(slope - self.face[triangle]).max(1)
        for k in range(3):
            at_edge, at_corner = weights[:, k - 1] < 1e-5, weights[:, k] > 1 - 1e-5
            for normal, here in ((self.edge[triangle, k], at_edge), (self.corner[self._faces[triangle, k]], at_corner)):
                found = np.where(here, np.minimum(found, np.abs(slope - normal).max(1)), found)
        return float(found.max(initial=0))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors over their lengths; zero where they have none."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


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
