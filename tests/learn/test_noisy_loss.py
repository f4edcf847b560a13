"""The loss of noisy estimates has the mean that the loss of their mean has, and so have its derivatives."""

import mitsuba as mi
import numpy as np

from ndf_mi.colour import linear_to_srgb
from ndf_mi.learn.loss import NoisyLoss

RAYS, SAMPLES, REPEATS = 64, 4, 2000


def test_neither_error_nor_derivatives_are_biased_by_noise():
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.05, 0.9, (3, RAYS))
    mean = truth + rng.uniform(-0.03, 0.05, truth.shape)
    loss = NoisyLoss(SAMPLES)
    errors, moves = [], []
    for _ in range(REPEATS):
        # Noise as of paths: much larger than the error, skewed, and moved by a parameter that scales the estimates.
        estimates = np.repeat(mean, SAMPLES, axis=1) * rng.exponential(1.0, (3, RAYS * SAMPLES))
        error, adjoint = loss(mi.Color3f(estimates.astype(np.float32)), mi.Color3f(linear_to_srgb(truth).astype(np.float32)))
        errors.append(float(error[0]))
        moves.append(float((adjoint.numpy() * estimates).sum()))
    slope = (linear_to_srgb(truth + 1e-5) - linear_to_srgb(truth - 1e-5)) / 2e-5
    exact = np.mean((slope * (mean - truth)) ** 2)
    moved = np.mean(2 * slope**2 * (mean - truth) * mean)
    for found, expected in ((errors, exact), (moves, moved)):
        deviation = np.std(found, ddof=1) / np.sqrt(REPEATS)
        assert abs(np.mean(found) - expected) < 4 * deviation
        assert deviation < 0.2 * abs(expected)


def test_it_is_the_error_in_srgb_to_first_order():
    target = np.full((3, RAYS), 0.5, np.float32)
    linear = np.repeat(np.full((3, RAYS), 0.2140411 + 1e-3), SAMPLES, axis=1).astype(np.float32)
    error, _ = NoisyLoss(SAMPLES)(mi.Color3f(linear), mi.Color3f(target))
    exact = float((linear_to_srgb(0.2140411 + 1e-3) - 0.5) ** 2)
    assert abs(float(error[0]) / exact - 1) < 0.02
