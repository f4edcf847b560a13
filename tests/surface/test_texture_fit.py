"""Fitting a texture to the images of a sphere."""

from __future__ import annotations

import time

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.surface.offset_fit import OffsetFit
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.schedule import Schedule, train, train_steps
from ndf_mi.surface.texture_fit import TextureFit, fit_texture
from ndf_mi.surface.textured import TexturedSurface


@pytest.fixture(scope="module")
def surface(capture) -> TexturedSurface:
    return TexturedSurface(capture, 32)


def test_convergence_ends_and_lowers_the_loss(capture, surface):
    fitted = fit_texture(surface, capture, 32, rate=0.1, schedule=Schedule(window_steps=16))
    history = fitted.training.history
    assert fitted.training.converged and not fitted.search.losses
    assert history[-1][2] < 1e-3 < history[0][2]
    assert fitted.texture.shape == (32, 32, 3) and fitted.texture.min() >= 0 and 0.5 < fitted.seen.mean() <= 1


def test_the_rate_is_the_best_of_a_search(capture, surface):
    short = Schedule(search_steps=3, search_frames=1, texture_rates=(1e-3, 1e-1))
    fitted = fit_texture(surface, capture, 32, seconds=0.1, schedule=short)
    losses = fitted.search.losses
    assert set(losses) == {"0.001", "0.1"} and min(losses, key=losses.get) == f"{fitted.search.rate:g}"


def test_same_seed_same_texture(capture, surface):
    results = []
    for seed in (3, 3, 4):
        fit = TextureFit(surface, capture, 32, 0.1, seed)
        train_steps(fit, Schedule(), 3)
        results.append(fit.texels.values())
    np.testing.assert_allclose(results[0], results[1], atol=1e-5)
    assert np.abs(results[0] - results[2]).max() > 1e-3


@pytest.mark.parametrize("kind", ["texture", "offsets"])
def test_no_file_is_read_once_training_begins(capture, surface, monkeypatch, kind):
    """Images, and masks where they are used, are in memory before a fit's seconds count."""
    if kind == "texture":
        fit = TextureFit(surface, capture, 32, 0.1, 0)
    else:
        fit = OffsetFit(surface, RestFrames(capture), capture, 32, 0.1, 0.02, 0)

    def late(camera, frame):
        pytest.fail("read while training")

    monkeypatch.setattr(capture, "image", late)
    monkeypatch.setattr(capture, "mask", late)
    start = time.perf_counter()
    training = train(fit, Schedule(), 0.05)
    assert training.steps >= 1 and training.seconds <= time.perf_counter() - start


def test_no_kernel_is_compiled_after_the_first_steps(capture, surface):
    fit = TextureFit(surface, capture, 32, 0.1, 0)
    train_steps(fit, Schedule(), 4)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        train_steps(fit, Schedule(), 6)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history and all(entry["cache_hit"] for entry in history)


def test_gradient_against_finite_differences(capture):
    surface = TexturedSurface(capture, 8)
    surface.set_frame(2)
    random = np.random.default_rng(0)
    texture, direction = random.uniform(0.2, 0.8, (2, 8, 8, 3)).astype(np.float32)

    def loss(value: mi.TensorXf) -> mi.Float:
        surface.set_texture(value)
        return dr.sum(dr.square(surface.render(capture.cameras["c1"], 4, seed=9)), axis=None)

    x = mi.TensorXf(texture)
    dr.enable_grad(x)
    dr.backward(loss(x))
    along = float((x.grad.numpy() * direction).sum())
    step = 1e-2
    ends = [float(loss(mi.TensorXf(texture + sign * step * direction)).array[0]) for sign in (1, -1)]
    assert along == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=2e-3)


def test_a_capture_without_training_images_is_refused(capture, surface, monkeypatch):
    monkeypatch.setitem(capture.splits, "train", type(capture.splits["train"])((), ()))
    for rate in (0.1, None):
        with pytest.raises(InputError, match="splits.train"):
            fit_texture(surface, capture, 32, rate)
