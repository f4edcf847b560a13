"""A surface in one pose: boxes, cells and normals are computed once, then points are projected."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.projection.bands import Bands
from ndf_mi.projection.cells import Cells
from ndf_mi.projection.local import CORNER_0, CORNER_1, EDGE_0, EDGE_2, Local, closest_on_triangle, unit
from ndf_mi.projection.refit import Frame, face_normals, refit, vertex_normals
from ndf_mi.projection.search import any_within, closest_pair
from ndf_mi.projection.surface import Surface

SORTED = 16384
"""Number of queries from which on sorting them pays."""

_ROUNDING = 1e-6
"""Below this fraction of the edges' length, rounding hides the direction of an offset."""


@dataclass
class Projection:
    """P_θ(x) = (u*, v*, l*) and the geometry behind it. Finite in every lane; undefined where `valid` is
    false.

    Attributes:
        uv: texture coordinates of the closest point, attached.
        l: signed distance, metres, negative inside. ∂l/∂x is the direction of steepest ascent. On the surface
            itself it is the normal; on edges and corners, the pseudonormal or the normal of an adjacent face.
            ∂l/∂vertices is that of the closest point's own triangle. First derivatives only.
        triangle: number of the closest triangle; 0 where not valid.
        barycentric: weights of its corners, attached.
        point: the closest point, world, attached.
        normal: unit, detached; the face's, or the pseudonormal of the edge or corner that the point lies on.
        valid: whether the lane is active and in the band: |l| <= band, or, where the band's width varies,
            −inside <= l <= outside.
        band: how far the band reaches outside and inside there, metres, attached; 0 for a band of one width.
    """

    uv: mi.Point2f
    l: mi.Float
    triangle: mi.UInt32
    barycentric: mi.Point3f
    point: mi.Point3f
    normal: mi.Normal3f
    valid: mi.Bool
    band: mi.Point2f


class PosedSurface:
    """A :class:`Surface` in one pose, ready for queries.

    Args:
        vertices: flat (3·V), world, metres; may carry gradients.
        band: δ > 0, metres: nothing farther from the surface than this is searched. Or a width for every
            place.

    Attributes:
        band: δ; the largest width where it varies.
        bbox: world box, slightly padded, of every point of the band.

    Raises:
        InputError: the number of vertices differs, one is not finite, or the band is not positive.

    All queries work in evaluated code, in symbolic loops and inside plugins' methods, as they use no local
    memory. No size that differs between poses enters a kernel as a constant.
    """

    def __init__(self, surface: Surface, vertices: mi.Float, band: float | Bands) -> None:
        self._bands = band if isinstance(band, Bands) else None
        if isinstance(band, Bands):
            band = max(band.outside, band.inside)
        if not band > 0:
            raise InputError("band", f"{band}", "a distance above 0, in metres")
        if dr.width(vertices) != 3 * surface.vertex_count:
            raise InputError("vertices", f"{dr.width(vertices)} numbers", f"3 · {surface.vertex_count}")
        self.surface = surface
        self.vertices = vertices
        self.band = float(band)
        with dr.suspend_grad():
            detached = dr.detach(vertices)
            positions = np.asarray(detached).reshape(-1, 3)
            if not np.isfinite(positions).all():
                raise InputError("vertices", "NaN or infinity", "finite coordinates, in metres")
            low, high = positions.min(0).astype(np.float64), positions.max(0).astype(np.float64)
            pad = self.band + 1e-3 * self.band + 1e-6 * float(np.abs(positions).max())
            around = low - pad, high + pad
            if self._bands is not None:
                # The band of a triangle lies in the hull of the balls around its corners, as widths are
                # linear.
                wide = self._bands.largest[:, None].astype(np.float64)
                around = ((positions - wide).min(0) - (pad - self.band),
                          (positions + wide).max(0) + (pad - self.band))
            # Opaque, or another band would mean another kernel.
            self._delta = dr.opaque(mi.Float, self.band)
            corners = (mi.Point3f(*corner.tolist()) for corner in around)
            self.bbox = mi.BoundingBox3f(*corners)
            self._frame = Frame(low, high, self.band)
            self._boxes = refit(surface, detached, self._frame)
            self._face_normals = face_normals(surface, detached)
            self._vertex_normals = vertex_normals(surface, detached, self._face_normals)
            self._cells = Cells(*around, self.band, self._frame, self._boxes, self._bands)

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """False only off the band for certain; reads one cell of a grid."""
        with dr.suspend_grad():
            return self._cells.may_contain(mi.Point3f(dr.detach(x)))

    def within_bands(self, x: mi.Point3f, bands: Bands, extra: float) -> tuple[mi.Bool, mi.Bool]:
        """Whether some triangle is within its own width, plus `extra` metres, of a point: by the larger of
        its two widths, and by that inside. Wherever such a triangle is, another one may be closer.

        A ball of radius `extra` about a point of which neither is true holds nothing of the band.
        """
        with dr.suspend_grad():
            q, more = self._frame.to_units(mi.Point3f(dr.detach(x))), dr.opaque(mi.Float, extra)
            root, scale = dr.full(mi.UInt32, 1, dr.width(x)), self._frame.scale * (1 + 1e-3)
            some = any_within(self._boxes, q, bands.reach, scale, more * scale, root, mi.UInt32(0))
            root = dr.select(some, root, 0)
            return some, any_within(self._boxes, q, bands.reach_inside, scale, more * scale, root,
                                    mi.UInt32(0))

    def closest(self, x: mi.Point3f, active: mi.Bool | bool = True) -> tuple[mi.UInt32, mi.Bool]:
        """The closest triangle's number and whether there is one, detached; 0 in lanes that are inactive or
        farther off than the band's largest width."""
        with dr.suspend_grad():
            x = mi.Point3f(dr.detach(x))
            cell, inside = self._cells.locate(x)
            active = mi.Bool(active) & inside
            if dr.flag(dr.JitFlag.SymbolicScope) or dr.width(x) < SORTED:
                found = self._search(x, cell, active)
            else:
                found = self._search_sorted(x, cell, active)
            hit = found < 2 * self.surface.leaves
            return dr.gather(mi.UInt32, self.surface.leaf_triangles, found, hit), hit

    def project(self, x: mi.Point3f, active: mi.Bool | bool = True) -> Projection:
        """P_θ(x): the search, detached, then :meth:`project_onto` the triangle found, attached."""
        triangle, found = self.closest(x, active)
        return self.project_onto(triangle, x, found)

    def project_onto(self, triangle: mi.UInt32, x: mi.Point3f, active: mi.Bool | bool = True) -> Projection:
        """Projects ``x`` onto a given triangle; ``valid`` where active and in the band."""
        surface = self.surface
        active = mi.Bool(active)
        corner = [dr.gather(mi.UInt32, surface.faces, 3 * triangle + k, active) for k in range(3)]
        v0, v1, v2 = (dr.gather(mi.Point3f, self.vertices, c, active) for c in corner)
        x = dr.select(active, mi.Point3f(x), 0)
        local = closest_on_triangle(x, v0, v1, v2)
        weights = local.barycentric
        with dr.suspend_grad():
            normal, l_value, slope = self._sign(triangle, corner, local, active)
        # The closest point minimises over its weights, so that their change adds nothing to that of l
        # (envelope theorem).
        fixed = dr.detach(weights)
        towards = (x - v0) * fixed.x + (x - v1) * fixed.y + (x - v2) * fixed.z
        l = dr.replace_grad(l_value, dr.dot(slope, towards))
        uv = mi.Point2f(0)
        for k in range(3):
            corner_uv = dr.gather(mi.Point2f, surface.corner_uv, 3 * triangle + k, active)
            uv = uv + mi.Point2f(corner_uv) * weights[k]
        if self._bands is None:
            band, valid = dr.zeros(mi.Point2f), active & (dr.abs(l_value) <= self._delta)
        else:
            band = self._bands.at(corner, weights, active)
            valid = active & (l_value <= dr.detach(band.x)) & (l_value >= -dr.detach(band.y))
        return Projection(uv, l, triangle, weights, x - local.offset, mi.Normal3f(normal), valid, band)

    def _sign(
        self, triangle: mi.UInt32, corner: list[mi.UInt32], local: Local, active: mi.Bool
    ) -> tuple[mi.Vector3f, mi.Float, mi.Vector3f]:
        """Pseudonormal, signed distance and its gradient (Bærentzen and Aanæs, "Signed distance computation
        using the angle weighted pseudonormal", 2005); the pseudonormal where rounding hides the direction."""
        offset, feature = dr.detach(local.offset), local.feature
        own = mi.Vector3f(dr.gather(mi.Point3f, self._face_normals, triangle, active))
        on_edge = (feature >= EDGE_0) & (feature <= EDGE_2)
        on_corner = feature >= CORNER_0
        edge = dr.select(on_edge, feature - EDGE_0, 0)
        across = dr.gather(mi.UInt32, self.surface.neighbours, 3 * triangle + edge, active & on_edge)
        neighbour = mi.Vector3f(dr.gather(mi.Point3f, self._face_normals, across, active & on_edge))
        other = dr.select(feature == CORNER_1, corner[1], corner[2])
        vertex = dr.select(feature == CORNER_0, corner[0], other)
        around = mi.Vector3f(dr.gather(mi.Point3f, self._vertex_normals, vertex, active & on_corner))
        normal = dr.select(on_edge, unit(own + neighbour, own), dr.select(on_corner, around, own))
        distance = dr.norm(offset)
        sign = dr.select(dr.dot(offset, normal) < 0, mi.Float(-1), mi.Float(1))
        # The offset is known to the edges' length times 6e-8. A triangle without a normal has nothing else.
        directed = (dr.squared_norm(offset) > _ROUNDING**2 * local.size2) | (dr.squared_norm(normal) == 0)
        slope = dr.select(directed, unit(offset, sign * normal) * sign, normal)
        slope = dr.select(on_edge | on_corner, slope, own)
        return normal, sign * distance, slope

    def _search(self, x: mi.Point3f, cell: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Number 2 · leaf + (0 or 1) of the closest triangle within δ, 2 · leaves where there is none."""
        bound = dr.square(self._delta * (1 + 1e-4) * self._frame.scale)
        node, trail = self._cells.start(cell, active)
        return closest_pair(self._boxes, self._frame.to_units(x), bound, node, trail)[1]

    def _search_sorted(self, x: mi.Point3f, cell: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """As :meth:`_search`, with the queries sorted by cell (a counting sort), so that neighbouring lanes
        walk the same nodes. The order within a cell is undefined; results do not depend on it."""
        count = dr.width(x)
        histogram = dr.zeros(mi.UInt32, self._cells.count)
        rank = dr.scatter_inc(histogram, cell, active)
        dr.eval(rank, cell, active, x)
        begin = dr.prefix_sum(histogram)
        none = 0xFFFFFFFF
        order = dr.full(mi.UInt32, none, count)
        place = dr.gather(mi.UInt32, begin, cell, active) + rank
        dr.scatter(order, dr.arange(mi.UInt32, count), place, active)
        some = order != none
        x, cell = dr.gather(mi.Point3f, x, order, some), dr.gather(mi.UInt32, cell, order, some)
        found = self._search(x, cell, some)
        result = dr.full(mi.UInt32, 2 * self.surface.leaves, count)
        dr.scatter(result, found, order, some)
        return result
