"""The surfaces that rays meet behind shells, and what happens to a path there, as in Mitsuba's `path`. Shapes
that only bound a medium are passed through."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


def next_surface(
    scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool, skip_emitters: bool = False
) -> mi.PreliminaryIntersection3f:
    """The first surface along each ray that is not passed through.

    Shapes whose BSDF is only `null` are passed through, unless they emit light; the ray is neither moved
    sideways nor bent.

    Args:
        skip_emitters: also pass through the shapes of area emitters.

    Returns:
        the intersection, detached; `t` is the distance from the ray's own origin, infinite where nothing is
        met within `ray.maxt`.
    """

    def passed(pi: mi.PreliminaryIntersection3f) -> mi.Bool:
        flags = pi.shape.bsdf().flags()
        null = (flags & int(mi.BSDFFlags.All)) == int(mi.BSDFFlags.Null)
        emits = pi.shape.emitter() != None  # noqa: E711 (an array of pointers)
        return null | emits if skip_emitters else null & ~emits

    def body(
        searching: mi.Bool, travelled: mi.Float, found: mi.PreliminaryIntersection3f
    ) -> tuple[mi.Bool, mi.Float, mi.PreliminaryIntersection3f]:
        onward = mi.Ray3f(ray)
        onward.o = ray(travelled)
        onward.maxt = ray.maxt - travelled
        pi = scene.ray_intersect_preliminary(onward, False, searching)
        pi.t = travelled + pi.t
        found = dr.select(searching, pi, found)
        through = searching & pi.is_valid()
        through &= passed(pi)
        found.t = dr.select(through, dr.inf, found.t)
        # A few units in the last place of the position: the smallest step that makes progress, so that
        # nothing behind is skipped. To meet the same triangle again does no harm, as nothing depends on the
        # number of crossings.
        reach = dr.max(dr.abs(ray(pi.t)))
        travelled = dr.select(through, pi.t + 16.0 * dr.epsilon(mi.Float) * (1.0 + reach + pi.t), travelled)
        searching = through & (travelled < ray.maxt)
        return searching, travelled, found

    with dr.suspend_grad():
        width = dr.width(ray.d)
        nothing = dr.zeros(mi.PreliminaryIntersection3f, width)
        nothing.t = dr.full(mi.Float, dr.inf, width)
        state = (mi.Bool(active) & dr.full(mi.Bool, True, width), dr.zeros(mi.Float, width), nothing)
        return dr.while_loop(state, lambda searching, *_: searching, body, label="surfaces behind shells")[2]


def occluded(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
    """Whether a surface that is not passed through (see :func:`next_surface`) lies within `ray.maxt`."""
    return next_surface(scene, ray, active).is_valid()


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
        point = dr.zeros(mi.Interaction3f, width)
        return cls(point, dr.full(mi.Float, 1.0, width), dr.full(mi.Bool, True, width))


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
    scattered = active & si.is_valid() & ~mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
    origin = Origin(point, bs.pdf, mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta))
    return Vertex(emitted, lit, shadow, si.spawn_ray(si.to_world(bs.wo)), mi.Color3f(weight), bs.eta,
                  scattered, onward, origin)
