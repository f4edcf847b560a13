"""Sites and windows, held against dense convolutions of ones by SciPy."""

import numpy as np
import pytest
from scipy import ndimage

from ndf_mi.errors import InputError
from ndf_mi.methods.neural_body.voxels import MISSING, OFFSETS, voxels

SHAPE = (16, 8, 24)


@pytest.fixture(scope="module")
def found():
    rng = np.random.default_rng(0)
    return voxels(rng.uniform(0, 1, (120, 3)) * (np.array(SHAPE) - 1), SHAPE, 3)


def occupied(stride):
    dense = np.zeros(stride.shape, bool)
    dense[tuple(stride.sites.T)] = True
    return dense


def test_sites_spread_by_the_window_and_are_halved(found):
    for fine, coarse in zip(found.strides, found.strides[1:], strict=False):
        spread = ndimage.binary_dilation(occupied(fine), np.ones((3, 3, 3)))
        np.testing.assert_array_equal(occupied(coarse), spread[::2, ::2, ::2])


def test_vertices_share_sites(found):
    rng = np.random.default_rng(0)
    points = np.rint(rng.uniform(0, 1, (120, 3)) * (np.array(SHAPE) - 1))
    np.testing.assert_array_equal(found.strides[0].sites[found.site], points)
    np.testing.assert_array_equal(found.count, np.bincount(found.site))
    assert found.count.max() > 1


def test_windows_and_their_transposes_agree(found):
    for stride, before in zip(found.strides, (None, *found.strides[:-1]), strict=True):
        for window, inputs, step in ((stride.same, stride.sites, 1),
                                     (stride.down, None if before is None else before.sites, 2)):
            if window is None:
                continue
            pairs = {(int(i), k, o) for o, row in enumerate(window.inputs) for k, i in enumerate(row)
                     if i != MISSING}
            assert pairs == {(i, k, int(o)) for i, row in enumerate(window.outputs)
                             for k, o in enumerate(row) if o != MISSING}
            assert all((inputs[i] == step * stride.sites[o] + OFFSETS[k]).all() for i, k, o in pairs)
            # Every pair is there that the sites allow.
            difference = inputs[:, None] - step * stride.sites[None]
            assert len(pairs) == (np.abs(difference).max(-1) <= 1).sum()


def test_a_box_of_too_many_voxels_is_refused():
    with pytest.raises(InputError, match="metres"):
        voxels(np.zeros((3, 3)), (4096, 4096, 4096), 5)
