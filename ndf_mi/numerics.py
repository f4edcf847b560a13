"""Elementary functions that Dr.Jit lacks and that keep their relative accuracy near zero, and sums that keep it over many terms."""

from __future__ import annotations

from typing import TypeVar

import drjit as dr
import mitsuba as mi

SINGLE = 256
"""Terms up to which sums are taken in single precision: of more, rounding is felt."""

T = TypeVar("T", bound=dr.ArrayBase)


def expm1(x: T) -> T:
    """eˣ − 1, without cancellation near 0, as tanh(x/2)·(eˣ + 1). For x ≤ 80; differentiable."""
    return dr.tanh(0.5 * x) * (dr.exp(x) + 1.0)


def log1p(x: T) -> T:
    """ln(1 + x) for x ≥ 0, accurate near 0 (Kahan's correction). The derivative is that of ln(1 + x) as it stands, where nothing
    cancels."""
    detached = dr.detach(x)
    u = 1.0 + detached
    rounded = u == 1.0
    value = dr.select(rounded, detached, dr.log(u) * (detached / dr.select(rounded, 1.0, u - 1.0)))
    return dr.replace_grad(value, dr.log(1.0 + x))


def softplus(x: T) -> T:
    """ln(1 + eˣ), finite and accurate for any x. First derivatives only: the logistic function, ½ at 0, where max and |·| have
    none."""
    detached = dr.detach(x)
    value = dr.maximum(detached, 0.0) + log1p(dr.exp(-dr.abs(detached)))
    logistic = dr.select(detached < 0, dr.exp(-dr.abs(detached)), 1.0) / (1.0 + dr.exp(-dr.abs(detached)))
    return dr.replace_grad(value, logistic * x)


def block_sum(values: mi.Float, count: int) -> mi.Float:
    """The sum of each `count` adjacent values: a number for each. Differentiable; above :data:`SINGLE` terms in double precision."""
    if count <= SINGLE:
        return dr.block_sum(values, count)
    return mi.Float(dr.block_sum(mi.Float64(values), count))


def sum_before(values: mi.Float, count: int) -> mi.Float:
    """Of each `count` adjacent values, the sum of those before each of them. Differentiable; in double precision as :func:`block_sum`."""
    if count <= SINGLE:
        return dr.block_prefix_sum(values, count, exclusive=True)
    return mi.Float(dr.block_prefix_sum(mi.Float64(values), count, exclusive=True))
