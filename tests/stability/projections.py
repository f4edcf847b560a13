"""Compares a projection onto a mesh, and its derivatives, with float64."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.projection import PosedSurface, Surface
from ndf_mi.stability.ball import charts
from ndf_mi.stability.case import TOLERANCE, error
from ndf_mi.stability.closest import closest, inside, on_triangles


@dataclass(frozen=True)
class Shape:
    """A mesh, float32 (V, 3) and (F, 3), in which every triangle is a chart.

    Attributes:
        closed: whether it has an inside.
        uv: (3F, 2) texture coordinates; by default, those of :func:`charts`.
    """

    vertices: np.ndarray
    faces: np.ndarray
    closed: bool = True
    uv: np.ndarray | None = None

    @property
    def corner_uv(self) -> np.ndarray:
        """(F, 3, 2) texture coordinates of the corners."""
        return (charts(len(self.faces))[0] if self.uv is None else self.uv).reshape(-1, 3, 2)

    @property
    def edge(self) -> float:
        """The longest edge in metres, but at least the spacing of float32 at the mesh."""
        corner = self.vertices.astype(np.float64)[self.faces]
        longest = float(np.linalg.norm(np.roll(corner, 1, 1) - corner, axis=2).max())
        return max(longest, float(np.spacing(np.abs(self.vertices).max())))

    def surface(self) -> Surface:
        """The mesh as the projection takes it."""
        return Surface(self.faces, self.corner_uv.reshape(-1, 2), charts(len(self.faces))[1], self.vertices)


def judge(shape: Shape, points: np.ndarray, band: float, sign: np.ndarray | None = None, smooth: bool = True,
          project: Callable = PosedSurface.project) -> tuple[float, float]:
    """Errors of the projection of points (N, 3), and of its derivatives.

    The distance is compared with the least to any triangle. Everything else is compared with the closest
    point of the triangle that was found, because several may be equally close. Lengths are relative to the
    longest edge and the distance.

    ∂l/∂x is compared with the triangle's normal where its interior is closest, at any distance; with the
    direction of the offset where an edge or a corner is closest, relative to the edge's length over the
    distance; and on edges and corners, where the offset has no direction, with the normals and pseudonormals
    that meet there. UVs, and their derivatives relative to the largest, are compared except on slivers.

    Args:
        shape: the mesh.
        points: queries.
        band: in metres; every point must be within.
        sign: (N,) of the distance, −1 or 1, or 0 where either is right; by default, from the solid angle if
            the shape is closed.
        smooth: compare derivatives of UVs. False where points lie on borders between triangles.
        project: the projection of a posed surface.
    """
    x = points.astype(np.float32)
    exact = x.astype(np.float64)
    vertices = shape.vertices.astype(np.float64)
    posed_vertices = mi.Float(np.ascontiguousarray(shape.vertices, np.float32).ravel())
    query = mi.Point3f(np.ascontiguousarray(x.T))
    dr.enable_grad(posed_vertices, query)
    found = project(PosedSurface(shape.surface(), posed_vertices, band), query)

    dr.backward(dr.sum(found.l), flags=dr.ADFlag.ClearInterior)
    slope, by_vertex = (
        dr.grad(query).numpy().T.astype(np.float64), dr.grad(posed_vertices).numpy().reshape(-1, 3))
    dr.set_grad(query, 0)
    dr.backward(dr.sum(found.uv.x + 2.0 * found.uv.y))
    uv_slope = dr.grad(query).numpy().T.astype(np.float64)

    nearest = closest(exact, vertices, shape.faces)
    triangle = found.triangle.numpy().astype(np.int64)
    corners, corner_uv = vertices[shape.faces[triangle]], shape.corner_uv[triangle].astype(np.float64)
    weights = on_triangles(exact, corners)
    l = found.l.numpy().astype(np.float64)
    if sign is None:
        sign = (
            np.where(inside(exact, vertices, shape.faces), -1, 1) if shape.closed else np.zeros(len(x), int))
    sign = np.where(sign == 0, np.nan_to_num(np.sign(l)), sign)
    length = shape.edge + nearest.distance
    normals = Normals(vertices, shape.faces)
    sine, reach = normals.sine[triangle], nearest.distance / np.maximum(normals.longest[triangle], 1e-300)

    wide = sine > 0.01
    own_weights = found.barycentric.numpy().T.astype(np.float64)
    # The weights of a sliver are hardly determined, only the point is.
    point, expected_point = (
        np.einsum("nk,nki->ni", w, corners - corners[:, :1]) for w in (own_weights, weights))
    uv = np.einsum("nk,nki->ni", weights, corner_uv)
    primal = max(error(l, sign * nearest.distance, length), error(point, expected_point, length[:, None]),
                 error(found.uv.numpy().T[wide], uv[wide], np.abs(corner_uv).max() * (1 + reach[wide, None])),
                 0.0 if bool(dr.all(found.valid)) else np.inf)

    on_face = weights.min(1) * sine > 1e-5 * (1 + reach)
    past_border = ~on_face & (nearest.distance > 2e-6 * shape.edge)
    on_border = ~on_face & (reach < 5e-7) & (sine > 1e-5)
    expected, scale = np.nan_to_num(slope), np.ones(len(x))
    expected[on_face], scale[on_face] = (
        normals.face[triangle[on_face]], np.where(sine[on_face] > 0.1, 1.0, 1 / sine[on_face]))
    offset = sign[:, None] * np.einsum("nk,nki->ni", weights, exact[:, None] - corners)
    expected[past_border] = _unit(offset)[past_border]
    # The direction of a very short offset may be off by half of it, but not reversed.
    scale[past_border] = np.minimum(1 + shape.edge / nearest.distance[past_border], 0.5 / TOLERANCE)
    unit = np.abs(np.linalg.norm(slope[on_face | past_border], axis=1) - 1).max(initial=0)
    expected_by_vertex, terms = np.zeros_like(vertices), np.zeros((len(vertices), 1))
    np.add.at(
        expected_by_vertex, shape.faces[triangle].ravel(),
        -(own_weights[:, :, None] * expected[:, None]).reshape(-1, 3))
    np.add.at(terms, shape.faces[triangle].ravel(), np.repeat(scale, 3)[:, None])
    gradient = max(
        error(slope, expected, scale[:, None]), float(unit),
        normals.off(slope[on_border], triangle[on_border], weights[on_border]),
        error(by_vertex, expected_by_vertex, 1.0 + terms), 0.0 if np.isfinite(uv_slope).all() else np.inf)
    if smooth:
        numeric = _uv_slope(exact, corners, corner_uv, 1e-5 * shape.edge)
        same = np.isfinite(numeric).all(1)
        gradient = max(gradient, error(uv_slope[same], numeric[same], np.abs(numeric[same]).max(initial=0)))
    return primal, gradient


class Normals:
    """Unit normals of a mesh in float64. An edge's is that of its faces' sum; a corner's is that of the sum
    of the faces around it, weighted by their angles there (Bærentzen and Aanæs 2005).

    Attributes:
        face: (F, 3), zero where there is no area.
        edge: (F, 3, 3), of the edges from corner k to corner k + 1.
        corner: (V, 3).
        longest: (F,) length of the longest edge.
        sine: (F,) the least height over the longest edge: about the sine of the smallest angle.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self._faces = faces
        corner = vertices[faces]
        sides = np.roll(corner, -1, 1) - corner
        cross = np.cross(sides[:, 0], -sides[:, 2])
        self.longest = np.linalg.norm(sides, axis=2).max(1)
        self.sine = np.linalg.norm(cross, axis=1) / np.maximum(self.longest**2, 1e-300)
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
        """How far slopes (N, 3), at points on the border of their triangle, are from the nearest of its
        normal and those of the edges and corner that the points, of weights (N, 3), are on."""
        found = np.abs(slope - self.face[triangle]).max(1)
        for k in range(3):
            on_edge, on_corner = weights[:, k - 1] < 1e-5, weights[:, k] > 1 - 1e-5
            for normal, here in (
                (self.edge[triangle, k], on_edge), (self.corner[self._faces[triangle, k]], on_corner)):
                found = np.where(here, np.minimum(found, np.abs(slope - normal).max(1)), found)
        return float(found.max(initial=0))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors over their lengths; zero where they have none."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def _uv_slope(x: np.ndarray, corners: np.ndarray, corner_uv: np.ndarray, step: float) -> np.ndarray:
    """(N, 3) derivatives of u + 2 v of the closest points on given triangles, by central differences; NaN
    where the closest point crosses a border within a few steps."""
    value = np.full(x.shape, np.nan)

    def part(weights: np.ndarray) -> np.ndarray:
        """Which part of the triangle a point is on: interior, edge or corner."""
        return (weights > 0).astype(int) + 2 * (weights >= 1)

    here = part(on_triangles(x, corners))
    for axis in range(3):
        ends, steady = [], np.ones(len(x), bool)
        for way in (1.0, -1.0):
            near, far = (
                on_triangles(x + way * distance * np.eye(3)[axis], corners) for distance in (step, 10 * step))
            ends.append(np.einsum("nk,nki->ni", near, corner_uv) @ [1.0, 2.0])
            steady &= (part(near) == here).all(1) & (part(far) == here).all(1)
        value[steady, axis] = ((ends[0] - ends[1]) / (2 * step))[steady]
    return value
