"""One vertex of a path on a surface, as in Mitsuba's `path`: emission, sampled emitter, sampled direction."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ndf_mi.render.surfaces import occluded


@dataclass
class Origin:
    """Where N rays were scattered, to weight emitters that they meet against sampling these emitters.

    Attributes:
        point: the place.
        pdf: of the ray's direction, per solid angle.
        delta: whether no other direction could have been sampled.
    """

    point: mi.Interaction3f
    pdf: mi.Float
    delta: mi.Bool

    @classmethod
    def camera(cls, width: int) -> Origin:
        """The origin of camera rays, which no emitter is sampled from."""
        return cls(
            dr.zeros(mi.Interaction3f, width), dr.full(mi.Float, 1.0, width), dr.full(mi.Bool, True, width)
        )


@dataclass
class Vertex:
    """What happens to N paths at the surfaces that they met, or in the environment; detached.

    Attributes:
        emitted: radiance of the emitter met, weighted against sampling it from the ray's origin.
        lit: radiance of a sampled emitter that is scattered back along the path, weighted; 0 if occluded.
        shadow: the segment to that emitter.
        onward: the path's next ray.
        weight: throughput of the next ray.
        eta: relative refractive index crossed.
        scattered: whether a surface was met, not merely passed through.
        active: whether the path may go on.
        origin: of the next ray.
    """

    emitted: mi.Color3f
    lit: mi.Color3f
    shadow: mi.Ray3f
    onward: mi.Ray3f
    weight: mi.Color3f
    eta: mi.Float
    scattered: mi.Bool
    active: mi.Bool
    origin: Origin


def sample_vertex(
    scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, found: mi.PreliminaryIntersection3f, origin: Origin,
    active: mi.Bool, environment: mi.Bool, last: bool,
) -> Vertex:
    """Evaluates emission, samples an emitter and samples the BSDF.

    Args:
        ray: N rays, scattered at `origin`.
        found: what they met.
        environment: whether the environment is visible to each ray.
        last: whether paths end here.
    """
    from mitsuba.ad.integrators.common import mis_weight  # Needs an active variant.

    si = found.compute_surface_interaction(ray, +mi.RayFlags.All, active)

    met = mi.DirectionSample3f(scene, si, origin.point)
    pdf = scene.pdf_emitter_direction(origin.point, met, active & ~origin.delta)
    emitted = met.emitter.eval(si, active & (origin.pdf > 0.0) & (environment | si.is_valid()))
    emitted = mi.Color3f(emitted * dr.select(origin.delta, 1.0, mis_weight(origin.pdf, pdf)))

    onward = active & si.is_valid() & (not last)
    bsdf = si.bsdf(ray)
    sampled = onward & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    ds, radiance = scene.sample_emitter_direction(si, sampler.next_2d(), False, sampled)
    sampled &= ds.pdf != 0.0
    value, pdf, bs, weight = bsdf.eval_pdf_sample(
        mi.BSDFContext(), si, si.to_local(ds.d), sampler.next_1d(), sampler.next_2d(), onward
    )
    lit = mi.Color3f(value * radiance * dr.select(ds.delta, 1.0, mis_weight(ds.pdf, pdf)))
    sampled &= dr.any(lit != 0.0)
    shadow = si.spawn_ray_to(ds.p)
    lit = dr.select(sampled & ~occluded(scene, shadow, sampled), lit, 0.0)
    # The point of an emitter at infinity lies behind all shapes, but a performer may extend beyond the shape
    # that carries it.
    shadow.maxt = dr.select(mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite), dr.inf, shadow.maxt)

    point = dr.zeros(mi.Interaction3f, dr.width(ray.d))
    point.t, point.time, point.wavelengths, point.p, point.n = si.t, si.time, si.wavelengths, si.p, si.n
    return Vertex(
        emitted=emitted,
        lit=lit,
        shadow=shadow,
        onward=si.spawn_ray(si.to_world(bs.wo)),
        weight=mi.Color3f(weight),
        eta=bs.eta,
        scattered=active & si.is_valid() & ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null),
        active=onward,
        origin=Origin(point, bs.pdf, mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)),
    )
