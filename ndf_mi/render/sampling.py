"""Where rays are sampled, and how the samples that matter are gathered."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

QUANTUM = 2048
"""Compacted arrays have this size, or that of a few multiples: each new size means new kernels."""


def box_interval(box: mi.BoundingBox3f, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
    """Intervals in which rays are inside an axis-aligned box, in front of their origins and within `maxt`.

    Returns:
        hit, near, far; near = far = 0 where the box is missed.
    """
    low, high = mi.Point3f(box.min), mi.Point3f(box.max)
    # The box changes with the pose: a literal would be compiled into the kernel.
    dr.make_opaque(low, high)
    hit, near, far = mi.BoundingBox3f(low, high).ray_intersect(ray)
    near = dr.maximum(near, 0.0)
    far = dr.minimum(far, ray.maxt)
    hit &= far > near
    return hit, dr.select(hit, near, 0.0), dr.select(hit, far, 0.0)


def stratified(
    near: mi.Float, far: mi.Float, samples: int, jitter: mi.Float | None
) -> tuple[mi.Float, mi.Float]:
    """Positions t and widths δ of `samples` equal strata between near and far (N): both N·samples, a ray's
    samples adjacent and in rising t. The last stratum ends at far: no interval is infinite.

    Args:
        jitter: N·samples values in [0, 1), where in its stratum each sample lies; None for the centres.
    """
    rays = dr.width(near)
    index = dr.arange(mi.UInt32, rays * samples)
    ray = index // samples
    offset = mi.Float(index - ray * samples) + (0.5 if jitter is None else jitter)
    width = dr.gather(mi.Float, (far - near) / samples, ray)
    return dr.fma(offset, width, dr.gather(mi.Float, near, ray)), width


def pad(chosen: mi.UInt32, count: int, size: int, first: int = 0) -> tuple[mi.UInt32, mi.Bool]:
    """`count` of the chosen indices from position `first` on, filled up with zeros to `size`, and which
    entries are real. Evaluated."""
    lane = dr.arange(mi.UInt32, size)
    real = lane < dr.opaque(mi.UInt32, count)
    if count == 0:
        return dr.zeros(mi.UInt32, size), real
    index = dr.gather(mi.UInt32, chosen, lane + dr.opaque(mi.UInt32, first), real)
    dr.eval(index, real)
    return index, real


def join(parts: Sequence[mi.Float]) -> mi.Float:
    """The parts one after the other; a single one is not copied."""
    return parts[0] if len(parts) == 1 else dr.concat(parts)


def rounded(count: int, unit: int) -> int:
    """The smallest of `unit` times 1, 3/2, 2, 3, 4, 6, 8, 12, … that is at least `count`; `unit` is even."""
    size, other = unit, unit // 2 * 3
    while size < count:
        size, other = other, 2 * size
    return size


def compact(mask: mi.Bool) -> tuple[mi.UInt32, mi.Bool, int]:
    """The lanes where a mask holds, padded to one of a few sizes (:func:`rounded`).

    Sizes are Python numbers that enter kernels: each new one costs a compilation.

    Returns:
        the chosen lanes' indices (0 in the padding), which entries are real, and how many those are.
        Evaluates `mask`.
    """
    chosen = dr.compress(mask)
    count = dr.width(chosen)
    return *pad(chosen, count, rounded(count, QUANTUM)), count
