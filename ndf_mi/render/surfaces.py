"""The surfaces that rays meet behind shells: shapes that only bound a medium are passed through."""

from __future__ import annotations

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
        return dr.while_loop(
            state=state, cond=lambda searching, *_: searching, body=body, label="surfaces behind shells"
        )[2]


def occluded(scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
    """Whether a surface that is not passed through (see :func:`next_surface`) lies within `ray.maxt`."""
    return next_surface(scene, ray, active).is_valid()
