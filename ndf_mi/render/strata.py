"""A field in the strata of rays, evaluated only where it may be anything but empty: what every integration along rays begins with.

Candidates, one a stratum, are thinned by a cheap test; what is left is gathered and located, thinned again to what lies in the field,
gathered again, and only then evaluated. Where candidates are, and which are evaluated, is detached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ndf_mi.field.sample import FieldSample
from ndf_mi.render.sampling import box_interval, compact, stratified


class VolumeField(Protocol):
    """What can be rendered: something in a box that knows cheaply where it is empty, and what it is elsewhere."""

    bbox: mi.BoundingBox3f

    strata: int
    """Factor on the candidate samples a ray."""

    def near(self, x: mi.Point3f) -> mi.Bool:
        """False only where the field is empty for certain."""
        ...

    def locate(self, x: mi.Point3f, active: mi.Bool) -> tuple[Any, mi.Bool]:
        """Detached search: a handle of each point (an array to be gathered from), and whether the field is defined there."""
        ...

    def density(self, x: mi.Point3f, handle: Any, active: mi.Bool) -> mi.Float:
        """σ at located points in 1/m, times the number of samples that each stands for; detached. Only asked for to find what is hidden."""
        ...

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, handle: Any, active: mi.Bool) -> FieldSample:
        """The field at located points; inactive lanes must be finite and are ignored."""
        ...


@dataclass
class Strata:
    """A field along N rays, `count` strata a ray, the N·count lanes of a ray beside one another in rising t.

    Attributes:
        count: strata a ray.
        near, width: N; where the first stratum begins and how wide each is, in scene units. Both 0 where the field's box is missed.
        t, delta: N·count; the place of the candidate in each stratum, and the stratum's width.
        sample: the field where it was evaluated, K lanes with the padding; attached to the rays.
        index, real: K; the stratum of each of these lanes, and whether it is one or padding.
        evaluated: how many are real.
    """

    count: int
    near: mi.Float
    width: mi.Float
    t: mi.Float
    delta: mi.Float
    sample: FieldSample
    index: mi.UInt32
    real: mi.Bool
    evaluated: int

    def spread(self, value: mi.Float) -> mi.Float:
        """From one lane a sample to one a stratum; zero where nothing was evaluated."""
        return scatter(value, self.index, self.real, dr.width(self.t))

    def optical_depth(self, scale: float = 1.0) -> mi.Float:
        """τ_i = σ_i δ_i of each stratum; `scale` is a factor on the density."""
        sigma = self.sample.sigma if self.sample.weight is None else self.sample.sigma * self.sample.weight
        if scale != 1.0:
            sigma = sigma * dr.opaque(mi.Float, scale)
        return self.spread(sigma) * self.delta


def sample_strata(
    volume: VolumeField,
    ray: mi.Ray3f,
    samples: int,
    *,
    jitter: mi.Float | None = None,
    window: tuple[int, int] | None = None,
    active: mi.Bool | bool = True,
    hidden: float = 0.0,
) -> Strata:
    """Evaluates `volume` in equal strata of the rays' way through its box.

    Args:
        ray: N rays, directions of unit length, that end at `maxt`.
        samples: candidates a ray, times the field's own `strata`.
        jitter: N numbers in [0, 1) a stratum looked at, where in it the candidate lies, a ray's beside one another; None for the middles.
        window: first of the samples and how many of them to look at: the part of the ray that those strata cover. None for all.
        active: N; the others count as missing the box.
        hidden: samples that less than this share of the light gets to, past those before, are left out: for where an evaluation is much
            dearer than one of the densities alone, which this costs. 0 for none.
    """
    first, count = window or (0, samples)
    first, count, samples = first * volume.strata, count * volume.strata, samples * volume.strata
    rays = dr.width(ray.d)

    def at(lane: mi.UInt32, t: mi.Float) -> tuple[mi.Point3f, mi.Vector3f]:
        parent = lane // count
        d = dr.gather(mi.Vector3f, ray.d, parent)
        return mi.Point3f(dr.gather(mi.Point3f, ray.o, parent) + d * t), d

    with dr.suspend_grad():
        hit, near, far = box_interval(volume.bbox, ray)
        hit &= active
        if window is not None:
            step = (far - near) / samples
            # A literal would be compiled into a kernel for each window.
            near = dr.fma(step, dr.opaque(mi.Float, first), near)
            far = dr.fma(step, count, near)
        t, delta = stratified(near, far, count, jitter)
        lane = dr.arange(mi.UInt32, rays * count)
        candidate = dr.gather(mi.Bool, hit, lane // count) & volume.near(at(lane, t)[0])
        width = (far - near) / count
        dr.eval(candidate, t, delta, near, width)
        chosen, real, _ = compact(candidate)
        handle, inside = volume.locate(at(chosen, dr.gather(mi.Float, t, chosen))[0], real)
        inside &= real
        dr.eval(handle, inside)
        second, real, evaluated = compact(inside)
        index = dr.gather(mi.UInt32, chosen, second)
        handle = dr.gather(type(handle), handle, second)
        dr.eval(index, handle, real)
        if hidden > 0:
            sigma = volume.density(at(index, dr.gather(mi.Float, t, index))[0], handle, real)
            before = dr.block_prefix_sum(scatter(sigma, index, real, rays * count) * delta, count, exclusive=True)
            third, real, evaluated = compact(real & (dr.gather(mi.Float, before, index, real) < -math.log(hidden)))
            index = dr.gather(mi.UInt32, index, third)
            handle = dr.gather(type(handle), handle, third)
            dr.eval(index, handle)

    x, d = at(index, dr.gather(mi.Float, t, index))
    return Strata(count, near, width, t, delta, volume.evaluate(x, d, handle, real), index, real, evaluated)


def scatter(value: mi.Float, index: mi.UInt32, active: mi.Bool, width: int) -> mi.Float:
    """`width` lanes with the active lanes of `value` at their indices, each index once, and zero elsewhere."""
    target = dr.zeros(mi.Float, width)
    dr.scatter(target, value, index, active, mode=dr.ReduceMode.Permute)
    return target
