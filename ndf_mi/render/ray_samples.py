"""Stratified samples of a field along rays, evaluated only where the field may be anything but empty.

There is one candidate a stratum. Those that pass a cheap test are located; those that lie in the field are
evaluated, each time gathered into shorter arrays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi

from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.render.sampling import box_interval, compact, stratified


class VolumeField(Protocol):
    """What can be rendered: a field in a box, with a cheap test for where it is empty."""

    bbox: mi.BoundingBox3f

    sample_factor: int
    """Factor on the candidate samples a ray."""

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """False only where the field is certainly empty."""
        ...

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """Where points lie relative to the field's surface, detached; `valid` where to evaluate the field."""
        ...

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """σ at located points in 1/m, zero in inactive lanes; detached. Finds what is behind opaque parts."""
        ...

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """The field at located points; inactive lanes must be finite and are ignored."""
        ...


class BoundedField(VolumeField, Protocol):
    """A field with a bound on its density."""

    majorant: float
    """Strictly above every density, in 1/m."""


@dataclass
class Stratified:
    """A field along N rays, `count` strata a ray; the N·count strata of a ray are adjacent and in rising t.

    Attributes:
        count: strata a ray.
        near, width: N; where the first stratum begins and how wide each is, in scene units. Both 0 where the
            field's box is missed.
        t, delta: N·count; the place of the candidate in each stratum, and the stratum's width.
        sample: the field where it was evaluated, K lanes with the padding; attached to the rays.
        weight: K; how many samples each of these stands for.
        index, real: K; the stratum of each of these lanes, and whether it is one or padding.
        evaluated: how many are real.
    """

    count: int
    near: mi.Float
    width: mi.Float
    t: mi.Float
    delta: mi.Float
    sample: FieldSample
    weight: mi.Float
    index: mi.UInt32
    real: mi.Bool
    evaluated: int

    def spread(self, value: mi.Float) -> mi.Float:
        """From one lane a sample to one a stratum; zero where nothing was evaluated."""
        return scatter(value, self.index, self.real, dr.width(self.t))

    def optical_depth(self, scale: float = 1.0) -> mi.Float:
        """τ_i = σ_i δ_i of each stratum; `scale` is a factor on the density."""
        sigma = self.sample.sigma * self.weight
        if scale != 1.0:
            sigma = sigma * dr.opaque(mi.Float, scale)
        return self.spread(sigma) * self.delta


def sample_rays(
    volume: VolumeField, ray: mi.Ray3f, samples: int, *, jitter: mi.Float | None = None,
    window: tuple[int, int] | None = None, active: mi.Bool | bool = True, min_transmittance: float = 0.0,
) -> Stratified:
    """Evaluates `volume` in equal strata of the rays' intervals in its box.

    Args:
        ray: N rays, directions of unit length, that end at `maxt`.
        samples: candidates a ray, times the field's `sample_factor`.
        jitter: N numbers in [0, 1) a stratum, a ray's adjacent: where in its stratum the candidate lies; None
            for the middles.
        window: the first sample and the number of samples to take, for the part of the ray that their strata
            cover; None for all.
        active: N; the others count as missing the box.
        min_transmittance: samples whose transmittance is below this are skipped. Their transmittance follows
            from the densities alone, evaluated once more for it, which pays where an evaluation costs much
            more. 0 skips none.
    """
    first, count = window or (0, samples)
    first, count, samples = (n * volume.sample_factor for n in (first, count, samples))
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
        candidate = dr.gather(mi.Bool, hit, lane // count) & volume.may_contain(at(lane, t)[0])
        width = (far - near) / count
        dr.eval(candidate, t, delta, near, width)
        index, real, _ = compact(candidate)
        located = volume.locate(at(index, dr.gather(mi.Float, t, index))[0], real)
        located.valid &= real
        dr.eval(located)
        index, located, real, evaluated = _thinned(index, located, located.valid)
        if min_transmittance > 0:
            x, _ = at(index, dr.gather(mi.Float, t, index))
            sigma = volume.density(x, located, real) * located.weight
            tau = scatter(sigma, index, real, rays * count) * delta
            before = dr.block_prefix_sum(tau, count, exclusive=True)
            seen = real & (dr.gather(mi.Float, before, index, real) < -math.log(min_transmittance))
            index, located, real, evaluated = _thinned(index, located, seen)

    x, d = at(index, dr.gather(mi.Float, t, index))
    sample = volume.evaluate(x, d, located, real)
    return Stratified(count, near, width, t, delta, sample, located.weight, index, real, evaluated)


def _thinned(index: mi.UInt32, located: Located, keep: mi.Bool) -> tuple[mi.UInt32, Located, mi.Bool, int]:
    """The lanes to keep, padded as by :func:`compact`: strata, locations, which are real and how many."""
    lane, real, count = compact(keep)
    index, located = dr.gather(mi.UInt32, index, lane), dr.gather(Located, located, lane)
    # Kernels that use `located` gather it themselves, which costs less than a kernel that only copies.
    dr.eval(index, real)
    return index, located, real, count


def scatter(value: mi.Float, index: mi.UInt32, active: mi.Bool, width: int) -> mi.Float:
    """`width` lanes with the active lanes of `value` at their indices, zero elsewhere."""
    target = dr.zeros(mi.Float, width)
    dr.scatter(target, value, index, active, mode=dr.ReduceMode.Permute)
    return target
