"""The padded box that pixels are drawn from and figures are over."""

from __future__ import annotations

import numpy as np

from ndf_mi.body.box import BOX_PADDING, padded_box


def test_box_of_two_points():
    low, high = padded_box(np.array([[0, 1, 2], [-1, 3, 2]], np.float32), 0.25)
    np.testing.assert_array_equal(low, [-1.25, 0.75, 1.75])
    np.testing.assert_array_equal(high, [0.25, 3.25, 2.25])


def test_the_default_padding_is_that_of_neural_body():
    low, high = padded_box(np.zeros((1, 3)))
    assert BOX_PADDING == 0.05
    np.testing.assert_allclose(high - low, 0.1)
