"""Emission and absorption of several fields along ray segments: jointly where fields overlap.

Along a segment of length t_s, with the extinctions σ_k and colours c_k of fields k,

    L = ∫_0^{t_s} T(t) Σ_k σ_k(t) c_k(t) dt,    T(t) = exp(−∫_0^t Σ_k σ_k(s) ds)

Every field is constant in each of its strata, which are those of `ndf_quadrature`. A field's optical depth is
then piecewise linear along the ray and can be evaluated at the ends of another field's strata, so that fields
need not share strata.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ndf_mi.numerics import block_sum, expm1, sum_before
from ndf_mi.render.ray_samples import Stratified, VolumeField, sample_rays, scatter
from ndf_mi.render.sampling import box_interval, join, pad, rounded

TILE = 4096
"""Largest number of rays integrated at once. It bounds the candidates' memory, at about 50 bytes each."""

OPAQUE = 1e34
"""Largest optical depth of a stratum. Sums of these are subtracted from one another, and so must not be
infinite."""

_RAYS = 256
"""Smallest number of rays integrated at once; smaller tiles are filled up."""


@dataclass
class Performer:
    """A field in a scene: `volume`, and `scale`, a factor on its density."""

    volume: VolumeField
    scale: float = 1.0


@dataclass
class Crossing:
    """What N segments see of all fields.

    Attributes:
        colour: L, linear radiance that reaches the segments' origins.
        transmittance: from the segments' ends to their origins.
        depth: Σ_i w_i t_i, the expected distance times the opacity, in metres.
    """

    colour: mi.Color3f
    transmittance: mi.Float
    depth: mi.Float


@dataclass
class _Medium:
    """One field along N rays.

    Attributes:
        tau: optical depth of each stratum.
        before: the field's optical depth from the ray's origin to each stratum.
        colour: of each stratum, 0 where nothing was evaluated.
    """

    strata: Stratified
    tau: mi.Float
    before: mi.Float
    colour: list[mi.Float]

    def optical_depth(self, ray: mi.UInt32, t: mi.Float) -> mi.Float:
        """From each ray's origin to the distance t; linear within strata, constant outside."""
        strata = self.strata
        width, near = dr.gather(mi.Float, strata.width, ray), dr.gather(mi.Float, strata.near, ray)
        place = dr.clip((t - near) / dr.maximum(width, 1e-20), 0.0, float(strata.count))
        stratum = dr.minimum(mi.UInt32(place), strata.count - 1)
        part = place - mi.Float(stratum)
        index = ray * strata.count + stratum
        return dr.fma(part, dr.gather(mi.Float, self.tau, index), dr.gather(mi.Float, self.before, index))


@dataclass
class Transport:
    """Integrates fields along segments.

    The number of segments that meet a field differs widely between camera rays, shadow rays and later
    bounces. Sizes enter kernels, so they are rounded up to a few.

    Args:
        samples: candidate samples a segment and field, times the field's `sample_factor`.
        tile: largest number of rays integrated at once.

    Attributes:
        evaluated: samples that reached a network since the object was made.
    """

    samples: int
    tile: int = TILE
    evaluated: int = 0

    def __call__(
        self, performers: Sequence[Performer], ray: mi.Ray3f, active: mi.Bool | bool = True,
        jitter: mi.Float | None = None,
    ) -> Crossing:
        """Radiance and transmittance of the segments ``[0, ray.maxt]`` of N rays (evaluated; directions of
        unit length). Inactive segments have radiance 0 and transmittance 1.

        Only rays that cross a field's box are integrated; the others cost one test of each box.
        Differentiable, by plain automatic differentiation, in everything that the fields' `evaluate` is
        attached to, but not in the rays.

        Args:
            jitter: N numbers in [0, 1): where in its stratum every sample of a ray lies; None for the
                centres.
        """
        width = dr.width(ray.d)
        with dr.suspend_grad():
            active = mi.Bool(active) & dr.full(mi.Bool, True, width)
            crossed = [box_interval(performer.volume.bbox, ray)[0] & active for performer in performers]
            number = dr.zeros(mi.UInt32, width)
            for hit in crossed:
                number += dr.select(hit, mi.UInt32(1), 0)
            # Most rays cross one box. Only those that cross several pay for all fields.
            alone = zip(performers, crossed, strict=True)
            groups = [([performer], hit & (number == 1)) for performer, hit in alone]
            if len(performers) > 1:
                groups.append((list(performers), number > 1))
            dr.eval([mask for _, mask in groups])
        indices, reals, rows = [], [], []
        for group, mask in groups:
            chosen = dr.compress(mask)
            count = dr.width(chosen)
            for first in range(0, count, self.tile):
                rays = min(self.tile, count - first)
                index, real = pad(chosen, rays, rounded(rays, _RAYS), first)
                indices.append(index)
                reals.append(real)
                rows.append(self._tile(group, ray, index, real, jitter))
        if not rows:
            zero = dr.zeros(mi.Float, width)
            return Crossing(mi.Color3f(zero), dr.full(mi.Float, 1.0, width), zero)
        index, real = join(indices), join(reals)
        tau, depth, *colour = [scatter(join(row), index, real, width) for row in zip(*rows, strict=True)]
        return Crossing(mi.Color3f(*colour), dr.exp(-tau), depth)

    def _tile(
        self, performers: list[Performer], ray: mi.Ray3f, index: mi.UInt32, real: mi.Bool,
        jitter: mi.Float | None,
    ) -> list[mi.Float]:
        """Optical depth, expected distance and the three colours of the chosen rays."""
        with dr.suspend_grad():
            part = mi.Ray3f(dr.gather(mi.Point3f, ray.o, index), dr.gather(mi.Vector3f, ray.d, index))
            part.maxt = dr.gather(mi.Float, ray.maxt, index)
            jitter = None if jitter is None else dr.gather(mi.Float, jitter, index)
        media = [self._medium(performer, part, real, jitter) for performer in performers]
        rows = [dr.zeros(mi.Float, dr.width(index)) for _ in range(5)]
        for one in media:
            weight = _weights(one, [other for other in media if other is not one])
            values = one.tau, weight * one.strata.t, *(weight * c for c in one.colour)
            for place, value in enumerate(values):
                rows[place] += block_sum(value, one.strata.count)
        dr.eval(rows)
        return rows

    def _medium(self, performer: Performer, ray: mi.Ray3f, real: mi.Bool, jitter: mi.Float | None) -> _Medium:
        volume = performer.volume
        if jitter is not None:
            jitter = dr.repeat(jitter, self.samples * volume.sample_factor)
        strata = sample_rays(volume, ray, self.samples, jitter=jitter, active=real)
        self.evaluated += strata.evaluated
        tau = dr.minimum(strata.optical_depth(performer.scale), OPAQUE)
        before = sum_before(tau, strata.count)
        return _Medium(strata, tau, before, [strata.spread(c) for c in strata.sample.colour])


def _weights(one: _Medium, others: list[_Medium]) -> mi.Float:
    """w_i = ∫ over stratum i of T(t) σ_i dt, the share of the stratum's colour that reaches the origin.

    If the optical depth of the others grows linearly by Δ within the stratum, this is exp(−τ(a_i)) · τ_i · (1
    − exp(−(τ_i + Δ))) / (τ_i + Δ), where τ(a_i) is the optical depth of all fields before the stratum.
    """
    if not others:
        return dr.exp(-one.before) * -expm1(-one.tau)
    strata = one.strata
    lane = dr.arange(mi.UInt32, dr.width(one.tau))
    ray = lane // strata.count
    stratum = mi.Float(lane - ray * strata.count)
    width = dr.gather(mi.Float, strata.width, ray)
    start = dr.fma(stratum, width, dr.gather(mi.Float, strata.near, ray))
    ahead = one.before
    total = one.tau
    for other in others:
        begin = other.optical_depth(ray, start)
        ahead = ahead + begin
        more = other.optical_depth(ray, start + width) - begin
        # Rounding must not make an empty interval negative. `maximum` would halve or drop the derivative of
        # an empty one.
        total = total + dr.select(more < 0, 0.0, more)
    # Near 0 by a series, as the quotient has no derivative there.
    small = total < 1e-3
    safe = dr.select(small, 1.0, total)
    series = one.tau * dr.fma(total, dr.fma(total, 1 / 6, -0.5), 1.0)
    return dr.exp(-ahead) * dr.select(small, series, -expm1(-safe) * (one.tau / safe))

