"""The paper's rendering equation: emission and absorption along a ray, by quadrature.

    L = Σ_i T_i (1 − exp(−σ_i δ_i)) c_i,    T_i = exp(−Σ_{j<i} σ_j δ_j)

Only samples that can lie in the band are projected, and only those in it reach the networks.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ndf_mi.field.sample import FieldSample
from ndf_mi.numerics import block_sum, expm1, sum_before
from ndf_mi.render.ray_samples import VolumeField, sample_rays


@dataclass
class Radiance:
    """What N rays see of a field.

    Attributes:
        colour: L, linear, premultiplied; composite a background B as L + (1 − opacity)·B.
        opacity: 1 − transmittance of the whole ray.
        depth: expected distance along the ray to the field, in scene units; 0 where the opacity is 0.
        u, normal: expected (u, v, l) and normal there; None unless asked for.
        samples: the field at the samples that reached the networks, for regularisers.
        inside: which lanes of `samples` are real rather than padding.
        evaluated: how many are.
    """

    colour: mi.Color3f
    opacity: mi.Float
    depth: mi.Float
    u: mi.Point3f | None
    normal: mi.Normal3f | None
    samples: FieldSample
    inside: mi.Bool
    evaluated: int


def quadrature(
    volume: VolumeField, ray: mi.Ray3f, samples: int, *, jitter: mi.Float | None = None,
    window: tuple[int, int] | None = None, scale: float = 1.0, min_transmittance: float = 0.0,
    geometry: bool = False,
) -> Radiance:
    """Renders `volume` along N rays (directions of unit length) with `samples` candidate samples each.

    Differentiable in the rays and in everything that `volume.evaluate` is attached to.

    Args:
        jitter, window, min_transmittance: as in :func:`ndf_mi.render.ray_samples.sample_rays`.
        scale: factor on the density.
        geometry: also return (u, v, l) and normals.
    """
    rays = max(dr.width(ray.o), dr.width(ray.d))
    ray = mi.Ray3f(ray)
    ray.o = ray.o + dr.zeros(mi.Vector3f, rays)
    ray.d = ray.d + dr.zeros(mi.Vector3f, rays)
    strata = sample_rays(volume, ray, samples, jitter=jitter, window=window,
                         min_transmittance=min_transmittance)
    sample = strata.sample
    tau = strata.optical_depth(scale)
    weight = dr.exp(-sum_before(tau, strata.count)) * -expm1(-tau)

    def expect(value: mi.Float) -> mi.Float:
        return block_sum(weight * strata.spread(value), strata.count)

    opacity = -expm1(-block_sum(tau, strata.count))
    norm = dr.rcp(dr.maximum(opacity, 1e-6))
    return Radiance(
        colour=mi.Color3f(*[expect(c) for c in sample.colour]),
        opacity=opacity,
        depth=block_sum(weight * strata.t, strata.count) * norm,
        u=mi.Point3f(*[expect(c) * norm for c in sample.u]) if geometry else None,
        normal=mi.Normal3f(*[expect(c) * norm for c in sample.normal]) if geometry else None,
        samples=sample,
        inside=strata.real,
        evaluated=strata.evaluated,
    )

