"""Elementary functions that Dr.Jit lacks and that keep their relative accuracy near zero."""

from __future__ import annotations

from typing import TypeVar

import drjit as dr

T = TypeVar("T", bound=dr.ArrayBase)


def expm1(x: T) -> T:
    """eˣ − 1, without cancellation near 0, as tanh(x/2)·(eˣ + 1). For x ≤ 80; differentiable."""
    return dr.tanh(0.5 * x) * (dr.exp(x) + 1.0)


def log1p(x: T) -> T:
    """ln(1 + x) for x ≥ 0, accurate near 0 (Kahan's correction); the derivative is that of 2·artanh(x / (2 + x)), the same
    function in a form whose derivative does not cancel."""
    u = 1.0 + dr.detach(x)
    rounded = u == 1.0
    value = dr.select(rounded, dr.detach(x), dr.log(u) * dr.detach(x) / dr.select(rounded, 1.0, u - 1.0))
    return dr.replace_grad(value, 2.0 * dr.atanh(x / (2.0 + x)))


def softplus(x: T) -> T:
    """ln(1 + eˣ), finite and accurate for any x. First derivatives only: the logistic function, ½ at 0, where max and |·| have
    none."""
    detached = dr.detach(x)
    value = dr.maximum(detached, 0.0) + log1p(dr.exp(-dr.abs(detached)))
    logistic = dr.select(detached < 0, dr.exp(-dr.abs(detached)), 1.0) / (1.0 + dr.exp(-dr.abs(detached)))
    return dr.replace_grad(value, logistic * x)
