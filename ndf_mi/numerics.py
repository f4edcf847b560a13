"""Functions that are accurate near zero and sums over many terms, which Dr.Jit lacks."""

from __future__ import annotations

import math
from typing import TypeVar

import drjit as dr
import mitsuba as mi

SINGLE = 256
"""Largest number of terms that are summed in single precision; the rounding of longer sums matters."""

T = TypeVar("T", bound=dr.ArrayBase)


def expm1(x: T) -> T:
    """eˣ − 1, without cancellation near 0. For x ≤ 80; first derivatives only.

    By series up to ½, where the last bits of exp may be wrong: on GPUs it is an approximation, as is tanh,
    whose error is 1e-5.
    """
    detached = dr.detach(x)
    value = dr.select(dr.abs(detached) < 0.5, detached * _exprel(detached), dr.exp(detached) - 1.0)
    return dr.replace_grad(value, dr.exp(x))


def saturated(a: T, limit: float) -> T:
    """limit·(1 − e^(−a/limit)) for a ≥ 0: a itself where it is small, down to the smallest floats, and never
    above `limit`. First derivatives only."""
    x = dr.detach(a) * (1.0 / limit)
    value = dr.select(x < 0.5, dr.detach(a) * _exprel(-x), limit * (1.0 - dr.exp(-x)))
    return dr.replace_grad(value, -limit * dr.exp(a * (-1.0 / limit)))


def _exprel(x: T) -> T:
    """(eˣ − 1) / x for |x| ≤ ½, by the first terms of its series."""
    value = dr.full(type(x), 1 / math.factorial(9), 1)
    for k in range(8, 0, -1):
        value = dr.fma(value, x, 1 / math.factorial(k))
    return value


def log1p(x: T) -> T:
    """ln(1 + x) for x ≥ 0, accurate near 0. Up to x = 1 by the series of 2·artanh(x / (2 + x)), as the
    logarithm of a number near 1 is an approximation on GPUs. The derivative is that of ln(1 + x), where
    nothing cancels."""
    detached = dr.detach(x)
    near = detached < 1.0
    s = dr.select(near, detached, 0.0) / (2.0 + dr.select(near, detached, 0.0))
    squared = s * s
    series = dr.full(type(x), 1 / 17, 1)
    for k in range(7, -1, -1):
        series = dr.fma(series, squared, 1 / (2 * k + 1))
    value = dr.select(near, 2.0 * s * series, dr.log(1.0 + detached))
    return dr.replace_grad(value, dr.log(1.0 + x))


def softplus(x: T) -> T:
    """ln(1 + eˣ), finite and accurate for any x. First derivatives only: the logistic function, ½ at 0."""
    detached = dr.detach(x)
    value = dr.maximum(detached, 0.0) + log1p(dr.exp(-dr.abs(detached)))
    logistic = dr.select(detached < 0, dr.exp(-dr.abs(detached)), 1.0) / (1.0 + dr.exp(-dr.abs(detached)))
    return dr.replace_grad(value, logistic * x)


def block_sum(values: mi.Float, count: int) -> mi.Float:
    """The sum of each `count` adjacent values. Differentiable; double precision above :data:`SINGLE`
    terms."""
    if count <= SINGLE:
        return dr.block_sum(values, count)
    return mi.Float(dr.block_sum(mi.Float64(values), count))


def sum_before(values: mi.Float, count: int) -> mi.Float:
    """For each value, the sum of those before it in its block of `count`. Differentiable; precision as in
    :func:`block_sum`."""
    if count <= SINGLE:
        return dr.block_prefix_sum(values, count, exclusive=True)
    return mi.Float(dr.block_prefix_sum(mi.Float64(values), count, exclusive=True))
