"""Removing and splitting primitives."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.methods.gaussians.densify import densify, rotated
from ndf_mi.methods.gaussians.primitives import Binding, initial


def test_invisible_ones_go_and_those_of_the_largest_scores_are_split():
    count = 6
    learned = initial(count, np.array([0.1, 0.2, 0.3]), np.random.default_rng(0))
    learned["colour"][0] = np.arange(count)
    learned["logit_opacity"][0, [1, 4]] = -9
    binding = Binding(np.arange(count, dtype=np.int32), np.full((count, 3), 1 / 3, np.float32))
    score = np.array([0.1, 9, 0, 0.4, 8, 0.3])
    found = densify(binding, learned, score, 0, np.random.default_rng(0))
    assert (found.removed, found.split) == (2, 2)
    np.testing.assert_array_equal(found.binding.triangle, [0, 2, 3, 5, 3, 5])
    np.testing.assert_array_equal(found.learned["colour"][0], [0, 2, 3, 5, 3, 5])
    scale = np.exp(found.learned["log_scale"])
    np.testing.assert_allclose(scale[:, 2:], np.tile(scale[:, :1] / 1.6, 4), rtol=1e-5)
    offset = found.learned["offset"]
    np.testing.assert_allclose(offset[:, [2, 3]], -offset[:, [4, 5]])
    assert np.abs(offset[:, 2:]).max() > 0.1 and not offset[:, :2].any()
    assert not learned["offset"].any()
    assert densify(binding, learned, score, 1, np.random.default_rng(0)).split == 3
    # What has never been seen is not split.
    assert densify(binding, learned, np.zeros(count), 3, np.random.default_rng(0)).split == 0


def test_rotated():
    rng = np.random.default_rng(1)
    quaternions, vectors = 3 * rng.normal(size=(4, 20)), rng.normal(size=(3, 20))
    expected = Rotation.from_quat(quaternions.T).apply(vectors.T).T
    np.testing.assert_allclose(rotated(quaternions, vectors), expected)
