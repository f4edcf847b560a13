"""The closest point on a given triangle in closed form, attached to query and vertices."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

FACE, EDGE_0, EDGE_1, EDGE_2, CORNER_0, CORNER_1, CORNER_2 = range(7)
"""The part of a triangle that the closest point lies on; edge k runs from corner k to corner k + 1."""


@dataclass
class Local:
    """The closest point of a triangle.

    Attributes:
        barycentric: weights of the three corners, in [0, 1], attached.
        feature: ``FACE`` … ``CORNER_2``, detached.
        offset: x − p, attached, metres.
        size2: square of the longer edge at the first corner, detached; the offset rounds in proportion to it.
    """

    barycentric: mi.Point3f
    feature: mi.UInt32
    offset: mi.Vector3f
    size2: mi.Float


def _guarded(value: mi.Float, least: float) -> mi.Float:
    """``value`` where it is a safe divisor, otherwise 1 without a gradient."""
    return dr.select(value > least, value, 1)


def closest_on_triangle(x: mi.Point3f, v0: mi.Point3f, v1: mi.Point3f, v2: mi.Point3f) -> Local:
    """Projects ``x`` onto the triangle (v0, v1, v2).

    The Voronoi region of x is found first (Ericson, *Real-Time Collision Detection*, 5.1.5) from detached
    values; then the weights are written for that region. On the face they follow from the parts of the second
    edge and of x that are orthogonal to the first edge (Gram and Schmidt: the 2 × 2 normal equations would
    lose twice as many digits in a thin triangle). On an edge they are a quotient of dot products; at a corner
    they are constants. A triangle without area (a sine below 1e-6 at v0) has no face region, and an edge
    without length has no interior, so that every value and gradient stays finite.
    """
    e1, e2, q = v1 - v0, v2 - v0, x - v0
    e3 = v2 - v1
    a, c = dr.squared_norm(e1), dr.squared_norm(e2)
    d1, d2 = dr.dot(q, e1), dr.dot(q, e2)
    length3 = dr.squared_norm(e3)
    d3 = dr.dot(x - v1, e3)
    least = 1e-30
    inverse = 1 / _guarded(a, least)
    r0, share = d1 * inverse, dr.dot(e1, e2) * inverse
    height, rejected = e2 - e1 * share, q - e1 * r0
    height2, up = dr.squared_norm(height), dr.dot(rejected, height)

    with dr.suspend_grad():
        t = up / _guarded(height2, 0)
        s = r0 - share * t
        face = (s >= 0) & (t >= 0) & (s + t <= 1) & (a > least) & (height2 > 1e-12 * c)
        along = [_clipped(d1, a), _clipped(d3, length3), 1 - _clipped(d2, c)]
        distance2 = [
            dr.squared_norm(q - e1 * along[0]),
            dr.squared_norm(x - v1 - e3 * along[1]),
            dr.squared_norm(q - e2 * (1 - along[2])),
        ]
        feature, best = mi.UInt32(FACE), mi.Float(dr.inf)
        for k in range(3):
            nearer = ~face & (distance2[k] < best)
            best = dr.select(nearer, distance2[k], best)
            here = dr.select(along[k] <= 0, CORNER_0 + k, EDGE_0 + k)
            here = dr.select(along[k] >= 1, CORNER_0 + (k + 1) % 3, here)
            feature = dr.select(nearer, here, feature)

    w2 = up / dr.select(face, height2, 1)
    w1 = r0 - share * w2
    weights = mi.Point3f(1 - w1 - w2, w1, w2)
    r1, r2 = d3 / _guarded(length3, least), d2 / _guarded(c, least)
    for which, value in (
        (EDGE_0, mi.Point3f(1 - r0, r0, 0)),
        (EDGE_1, mi.Point3f(0, 1 - r1, r1)),
        (EDGE_2, mi.Point3f(1 - r2, 0, r2)),
        (CORNER_0, mi.Point3f(1, 0, 0)),
        (CORNER_1, mi.Point3f(0, 1, 0)),
        (CORNER_2, mi.Point3f(0, 0, 1)),
    ):
        weights = dr.select(feature == which, value, weights)
    return Local(weights, feature, q - e1 * weights.y - e2 * weights.z, dr.detach(dr.maximum(a, c)))


def _clipped(along: mi.Float, length2: mi.Float) -> mi.Float:
    return dr.select(length2 > 1e-30, dr.clip(along / _guarded(length2, 1e-30), 0, 1), 0)


def unit(v: mi.Vector3f, otherwise: mi.Vector3f) -> mi.Vector3f:
    """``v`` over its length, or ``otherwise`` where it has none."""
    square = dr.squared_norm(v)
    return dr.select(square > 1e-30, v * dr.rsqrt(_guarded(square, 1e-30)), otherwise)
