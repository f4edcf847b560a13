"""Saturated densities and sums of many terms against float64, with their derivatives.

expm1, log1p and softplus are cases of the stability suite.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.numerics import SINGLE, block_sum, saturated, sum_before


def with_derivative(function, x):
    value = mi.Float(x)
    dr.enable_grad(value)
    out = function(value)
    dr.forward(value)
    return out.numpy().astype(np.float64), dr.grad(out).numpy().astype(np.float64)


@pytest.mark.parametrize("limit", [1.0, 500.0, 1e4])
def test_saturated(limit):
    """From the least normal numbers on it is what it saturates; it never passes its limit."""
    x = np.concatenate([[0], np.logspace(-37, 38, 1000)]).astype(np.float32)
    value, derivative = with_derivative(lambda a: saturated(a, limit), x)
    x64 = x.astype(np.float64)
    np.testing.assert_allclose(value, -limit * np.expm1(-x64 / limit), rtol=1e-6)
    np.testing.assert_allclose(derivative, np.exp(-x64 / limit), rtol=1e-5, atol=1e-30)
    assert value.max() <= limit


@pytest.mark.parametrize("count", [1, SINGLE, SINGLE + 1, 30_000])
def test_sums_of_many_terms(count):
    values = np.random.default_rng(count).uniform(0.5, 1.5, (3, count)).astype(np.float32)
    x = mi.Float(values.ravel())
    dr.enable_grad(x)
    exact = values.astype(np.float64)
    total, before = block_sum(x, count), sum_before(x, count)
    np.testing.assert_allclose(total.numpy(), exact.sum(1), rtol=2e-6)
    np.testing.assert_allclose(before.numpy().reshape(3, count), exact.cumsum(1) - exact, rtol=2e-6,
                               atol=1e-6)
    # Each value counts once in its total and once in the sum before each of those behind it, here with
    # weights.
    weights = np.random.default_rng(1).uniform(0.5, 1.5, (3, count)).astype(np.float32)
    dr.backward(dr.sum(total) + dr.sum(before * mi.Float(weights.ravel())))
    behind = weights.astype(np.float64)[:, ::-1].cumsum(1)[:, ::-1] - weights
    np.testing.assert_allclose(dr.grad(x).numpy().reshape(3, count), 1 + behind, rtol=4e-6)
