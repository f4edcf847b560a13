"""What rays see of Gaussian primitives, with gradients.

    L = Σ_i T_i α_i c_i,    T_i = Π_{j<i} (1 − α_j),    α_i = min(o_i exp(−½ |S_i⁻¹ R_iᵀ (p − μ_i)|²), 0.9999)

with p the point of the ray where the exponential is largest. A ray meets the primitives whose ellipsoids of
three standard deviations it enters, in the order in which it enters them, until T is at most 0.01. All this
is as in Mitsuba's integrator `volprim_rf_basic` (Condor et al. 2024, *Don't Splat your Gaussians*).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

EXTENT = 3.0
"""Standard deviations at which a primitive ends."""

MOST_OPAQUE = 0.9999
"""Largest α."""

Y00 = 0.28209479177387814
"""The spherical harmonic of degree 0."""


@dataclass(frozen=True)
class Posed:
    """N primitives in one pose, world space, metres; attached.

    Attributes:
        centre: μ.
        scale: standard deviations along the axes.
        rotation: R as a quaternion of unit length, from the axes to world space.
        opacity: o in [0, 1].
        colour: what the primitive emits in every direction, sRGB, at least 0.
    """

    centre: mi.Point3f
    scale: mi.Vector3f
    rotation: mi.Quaternion4f
    opacity: mi.Float
    colour: mi.Color3f

    def whitening(self) -> mi.Matrix3f:
        """S⁻¹Rᵀ, which maps the primitive to a ball of one standard deviation."""
        rotation = dr.quat_to_matrix(mi.Matrix3f, self.rotation)
        inverse = dr.rcp(self.scale)
        return mi.Matrix3f([[rotation[j, i] * inverse[i] for j in range(3)] for i in range(3)])


@dataclass(frozen=True)
class Hits:
    """Which primitives rays meet: ray by ray, front to back, padded.

    Attributes:
        primitive, ray: indices; 0 in the padding.
        first: index of the first hit of the same ray.
        real: False in the padding.
    """

    primitive: mi.UInt32
    ray: mi.UInt32
    first: mi.UInt32
    real: mi.Bool


def meet(posed: Posed, whitening: mi.Matrix3f, primitive: mi.UInt32, origin: mi.Point3f,
         direction: mi.Vector3f, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
    """Rays and one primitive each.

    Args:
        whitening: of all primitives.
        primitive: indices, one for each ray.
        origin, direction: of the rays, world space, unit directions.

    Returns:
        α, 0 in inactive lanes, and the distance in metres at which the ray enters the ellipsoid of `EXTENT`
        standard deviations, NaN where it misses it.
    """
    matrix = dr.gather(mi.Matrix3f, whitening, primitive, active)
    to_centre = dr.gather(mi.Point3f, posed.centre, primitive, active) - origin
    # From where the ray is closest to the centre all numbers are small: single precision suffices.
    along = dr.dot(to_centre, direction)
    start = matrix @ (direction * along - to_centre)
    step = matrix @ direction
    squared = dr.select(active, dr.squared_norm(step), 1.0)
    shift = -dr.dot(start, step) / squared
    distance = dr.squared_norm(start + step * shift)
    alpha = dr.gather(mi.Float, posed.opacity, primitive, active) * dr.exp(-0.5 * distance)
    entry = along + shift - dr.sqrt((EXTENT * EXTENT - distance) / squared)
    return dr.select(active, dr.minimum(alpha, MOST_OPAQUE), 0.0), entry


def composite(posed: Posed, hits: Hits, origin: mi.Point3f, direction: mi.Vector3f
              ) -> tuple[mi.Color3f, mi.Float]:
    """What N rays see of the primitives that they meet: premultiplied sRGB colour, and opacity; attached."""
    rays = dr.width(direction)
    alpha, _ = meet(posed, posed.whitening(), hits.primitive,
                    dr.gather(mi.Point3f, origin, hits.ray, hits.real),
                    dr.gather(mi.Vector3f, direction, hits.ray, hits.real), hits.real)
    # One sum over all rays, so in double precision.
    before = dr.prefix_reduce(dr.ReduceOp.Add, mi.Float64(-dr.log(1.0 - alpha)), exclusive=True)
    weight = dr.exp(mi.Float(dr.gather(mi.Float64, before, hits.first) - before)) * alpha
    colour = dr.gather(mi.Color3f, posed.colour, hits.primitive, hits.real)
    seen = [dr.zeros(mi.Float, rays) for _ in range(4)]
    for channel, value in zip(seen, [*(weight * colour), weight], strict=True):
        dr.scatter_reduce(dr.ReduceOp.Add, channel, value, hits.ray, hits.real)
    return mi.Color3f(*seen[:3]), seen[3]
