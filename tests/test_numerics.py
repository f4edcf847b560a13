"""expm1, log1p and softplus against numpy in float64, over all decades, with their derivatives."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.numerics import expm1, log1p, softplus


def with_derivative(function, x):
    value = mi.Float(x)
    dr.enable_grad(value)
    out = function(value)
    dr.forward(value)
    return out.numpy().astype(np.float64), dr.grad(out).numpy().astype(np.float64)


def test_expm1():
    x = np.concatenate([-np.logspace(-37, 1.9, 400), np.logspace(-37, 1.9, 400)]).astype(np.float32)
    value, derivative = with_derivative(expm1, x)
    np.testing.assert_allclose(value, np.expm1(x.astype(np.float64)), rtol=1e-5)
    np.testing.assert_allclose(derivative, np.exp(x.astype(np.float64)), rtol=1e-5, atol=1e-30)


def test_log1p():
    x = np.concatenate([[0], np.logspace(-37, 0, 400)]).astype(np.float32)
    value, derivative = with_derivative(log1p, x)
    np.testing.assert_allclose(value, np.log1p(x.astype(np.float64)), rtol=1e-6)
    np.testing.assert_allclose(derivative, 1 / (1 + x.astype(np.float64)), rtol=1e-5)


def test_softplus():
    x = np.concatenate([np.linspace(-80, 80, 801), [-1e30, 1e30, 0]]).astype(np.float32)
    value, derivative = with_derivative(softplus, x)
    x64 = x.astype(np.float64)
    np.testing.assert_allclose(value, np.logaddexp(0, x64), rtol=2e-6, atol=1e-37)
    np.testing.assert_allclose(derivative, 1 / (1 + np.exp(-np.clip(x64, -500, 500))), rtol=1e-5, atol=1e-37)
