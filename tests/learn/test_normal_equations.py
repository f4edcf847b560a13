"""The banded, bordered solution against a dense one; the precision against the inverse of the covariance."""

import numpy as np
import pytest

from ndf_mi.learn.normal_equations import NormalEquations, precision

FRAMES = np.array([0, 1, 4, 5, 9])


def matrix(links):
    kept, link = links
    return np.diag(kept) + np.diag(link, 1) + np.diag(link, -1)


@pytest.mark.parametrize("correlation", [0.0, 3.0])
def test_the_precision_is_the_inverse_of_the_covariance(correlation):
    apart = np.abs(FRAMES[:, None] - FRAMES)
    covariance = np.exp(-apart / correlation) if correlation else np.eye(5)
    np.testing.assert_allclose(matrix(precision(FRAMES, correlation)) @ covariance, np.eye(5), atol=1e-12)


@pytest.mark.parametrize(("own", "shared"), [(4, 3), (4, 0), (0, 3)])
def test_the_solution_is_the_dense_one(own, shared):
    rng = np.random.default_rng(0)
    pose, common, links = rng.normal(size=(5, own)), rng.normal(size=shared), precision(FRAMES, 3.0)
    equations = NormalEquations(pose, common, links)
    size = 5 * own + shared
    dense = np.zeros((size, size))
    dense[: 5 * own, : 5 * own] = np.kron(matrix(links), np.eye(own))
    dense[5 * own :, 5 * own :] = np.eye(shared)
    right = -dense @ np.concatenate([pose.ravel(), common])
    for frame in (0, 1, 1, 3, 4):
        a, b = rng.normal(size=(7, own)), rng.normal(size=(7, shared))
        r, w = rng.normal(size=7), rng.random(7)
        equations.add(frame, a, b, r, w)
        row = np.zeros((7, size))
        row[:, own * frame : own * (frame + 1)], row[:, 5 * own :] = a, b
        dense += row.T @ (w[:, None] * row)
        right += row.T @ (w * r)
    found = np.concatenate([value.ravel() for value in equations.solve()])
    np.testing.assert_allclose(found, np.linalg.solve(dense, right), atol=1e-10)
