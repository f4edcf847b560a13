"""Groups of corrections: those that are not trained are left out, and nothing else is."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.learn.corrections import GROUPS, NONE, Corrections, rows


def test_groups_are_those_that_are_trained():
    values = mi.Float(np.arange(6.0))
    dr.enable_grad(values)
    found = Corrections(cameras=values)
    assert GROUPS == ("pose", "shape", "cameras", "colours")
    assert NONE.groups() == {} and list(found.groups()) == ["cameras"]
    assert dr.grad_enabled(found.cameras) and not dr.grad_enabled(found.detached().cameras)
    np.testing.assert_array_equal(rows(values, 3), [[0, 1, 2], [3, 4, 5]])
