"""Losses against closed forms; the loss of noisy estimates has the mean that the loss of their mean has."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.colour import linear_to_srgb
from ndf_mi.learn.loss import ImageLoss, NoisyLoss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.render.quadrature import Radiance

RAYS, SAMPLES, REPEATS = 64, 4, 2000


def image_loss(**changes):
    options = dataclasses.replace(TrainingOptions(surface="body", edge_weight=0.0), **changes)
    return ImageLoss(options, mi.Color3f(0.0), band=0.08, density_gain=1.0)


def radiance(opacity):
    return Radiance(dr.zeros(mi.Color3f, dr.width(opacity)), opacity, *[None] * 5, 0)


def test_opacity_is_compared_where_the_mask_is_valid():
    loss, seen = image_loss(opacity_weight=1.0), radiance(mi.Float(0.5, 0.5))
    total = [loss(seen, mi.Color3f(0.0), mi.Float(1, 1), mi.Float(*valid)).total[0]
             for valid in ((1, 1), (1, 0), (0, 0))]
    np.testing.assert_allclose(total, [0.25, 0.125, 0])


def test_the_error_of_the_boxs_rays_is_reported_separately():
    """Of the rays drawn from the mask half miss by 0.5, of those from the box a quarter."""
    in_box = np.repeat([1.0, 0.0], 1000)
    miss = np.where(in_box == 1, np.arange(2000) % 4 == 0, np.arange(2000) % 2 == 0)
    loss, seen = image_loss(opacity_weight=0.0), radiance(dr.ones(mi.Float, 2000))
    found = loss(seen, mi.Color3f(mi.Float(0.5 * miss)), mi.Float(0), mi.Float(0), mi.Float(in_box))
    assert float(found.box[0]) == pytest.approx(0.25 / 4, rel=1e-5)
    assert float(found.image[0]) == pytest.approx(0.25 * 3 / 8, rel=1e-5)
    assert loss(seen, mi.Color3f(0.0), mi.Float(0), mi.Float(0)).box is None


def noisy_estimates():
    """True values, biased means, and repeated estimates of these: skewed noise, much larger than the bias."""
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.05, 0.9, (3, RAYS))
    mean = truth + rng.uniform(-0.03, 0.05, truth.shape)
    repeats = (np.repeat(mean, SAMPLES, axis=1) * rng.exponential(1.0, (3, RAYS * SAMPLES))
               for _ in range(REPEATS))
    return truth, mean, repeats


def test_noise_biases_neither_error_nor_derivatives():
    truth, mean, repeats = noisy_estimates()
    loss, target = NoisyLoss(SAMPLES), mi.Color3f(linear_to_srgb(truth).astype(np.float32))
    errors, derivatives = [], []
    for estimates in repeats:
        error, adjoint = loss(mi.Color3f(estimates.astype(np.float32)), target)
        errors.append(float(error[0]))
        # In a parameter that scales the estimates.
        derivatives.append(float((adjoint.numpy() * estimates).sum()))
    slope = (linear_to_srgb(truth + 1e-5) - linear_to_srgb(truth - 1e-5)) / 2e-5
    for found, expected in ((errors, np.mean((slope * (mean - truth)) ** 2)),
                            (derivatives, np.mean(2 * slope**2 * (mean - truth) * mean))):
        deviation = np.std(found, ddof=1) / np.sqrt(REPEATS)
        assert abs(np.mean(found) - expected) < 4 * deviation
        assert deviation < 0.2 * abs(expected)


def test_the_noisy_loss_is_the_error_in_srgb_to_first_order():
    target = np.full((3, RAYS), 0.5, np.float32)
    linear = np.repeat(np.full((3, RAYS), 0.2140411 + 1e-3), SAMPLES, axis=1).astype(np.float32)
    error, _ = NoisyLoss(SAMPLES)(mi.Color3f(linear), mi.Color3f(target))
    exact = float((linear_to_srgb(0.2140411 + 1e-3) - 0.5) ** 2)
    assert abs(float(error[0]) / exact - 1) < 0.02
