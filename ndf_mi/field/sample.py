"""What a field is at points, and where points were found: the values that fields and renderers exchange."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi


@dataclass
class Located:
    """Where N points lie relative to a field's surface, found by one search; detached.

    It is thinned as a value: ``dr.gather(Located, located, index)``. Lanes that are not `valid` are finite.

    Attributes:
        triangle: number of the closest triangle.
        uv: texture coordinates of the closest point.
        l: signed distance in metres.
        normal: unit surface normal at the closest point.
        barycentric: weights of the triangle's corners at the closest point; 0 if not used.
        valid: whether the field is to be evaluated here.
        weight: number of samples that this one stands for, where others were left out at random.
        band: how far the band reaches outside and inside there, in metres; 0 if that is the same everywhere.
    """

    triangle: mi.UInt32
    uv: mi.Point2f
    l: mi.Float
    normal: mi.Normal3f
    barycentric: mi.Point3f
    valid: mi.Bool
    weight: mi.Float
    band: mi.Point2f = field(default_factory=lambda: dr.zeros(mi.Point2f))

    @classmethod
    def anywhere(cls, valid: mi.Bool) -> Located:
        """Points of a field that has no surface; only `valid` and the weight, which is 1, have a meaning."""
        located = dr.zeros(cls, dr.width(valid))
        located.valid, located.weight = mi.Bool(valid), dr.full(mi.Float, 1.0, dr.width(valid))
        return located


@dataclass
class FieldSample:
    """A field at K points.

    Attributes:
        sigma: extinction in 1/m.
        colour: linear, in [0, 1].
        u: texture coordinates (u*, v*) and the signed distance l in metres.
        normal: unit normal of the surface at the closest point.
        band: how far the band reaches outside there, in metres; 0 if that is the same everywhere.
    """

    sigma: mi.Float
    colour: mi.Color3f
    u: mi.Point3f
    normal: mi.Normal3f
    band: mi.Float = field(default_factory=lambda: mi.Float(0))
