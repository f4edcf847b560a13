"""The sRGB curves against values published with the standard and against finite differences in float64."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.colour import linear_to_srgb, srgb_to_linear


def test_known_values():
    # Mid grey: linear 0.2140411 is sRGB 0.5; code 128 of 255 is linear 0.2158605.
    np.testing.assert_allclose(
        srgb_to_linear(np.array([0.0, 0.5, 128 / 255, 1.0])), [0, 0.2140411, 0.2158605, 1], atol=1e-6
    )
    np.testing.assert_allclose(linear_to_srgb(np.array([0.0, 0.2140411, 1.0])), [0, 0.5, 1], atol=1e-6)


def test_round_trip_keeps_float32():
    value = np.linspace(0, 1, 4097, dtype=np.float32)
    back = linear_to_srgb(srgb_to_linear(value))
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, value, atol=2e-6)


@pytest.mark.parametrize("curve", [linear_to_srgb, srgb_to_linear])
def test_drjit_agrees_with_numpy_and_gradients_are_finite(curve):
    value = np.array([-0.1, 0.0, 0.001, 0.01, 0.3, 0.9, 1.5], dtype=np.float32)
    x = mi.Float(value)
    dr.enable_grad(x)
    y = curve(x)
    np.testing.assert_allclose(np.array(y), curve(value.astype(np.float64)), atol=1e-6)
    dr.backward(y)
    wide, step = value.astype(np.float64), 1e-7
    difference = (curve(wide + step) - curve(wide - step)) / (2 * step)
    np.testing.assert_allclose(np.array(x.grad), difference, rtol=1e-4)
    tensor = curve(mi.TensorXf(value.reshape(7, 1)))
    assert tensor.shape == (7, 1)
