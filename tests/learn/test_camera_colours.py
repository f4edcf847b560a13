"""Maps of colour: their mean is the identity, they are undone as they are applied, and a white balance is
found."""

import copy

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.capture.document import Split
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.camera_colours import CameraColours
from ndf_mi.learn.corrections import Corrections
from ndf_mi.learn.loop import start
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.refined import seen_by


def with_training_cameras(capture, *names):
    changed = copy.copy(capture)
    changed.splits = capture.splits | {"train": Split(names, capture.splits["train"].frames)}
    return changed


def random_values(colours, seed=0):
    return mi.Float(np.random.default_rng(seed).normal(size=colours.count).astype(np.float32))


def test_the_mean_of_the_maps_is_the_identity():
    colours = CameraColours(3)
    tensors = colours.tensors(random_values(colours))
    np.testing.assert_allclose(tensors["colour_matrix"].mean(0), np.eye(3), atol=1e-6)
    np.testing.assert_allclose(tensors["colour_offset"].mean(0), 0, atol=1e-6)
    assert np.abs(tensors["colour_matrix"][0] - np.eye(3)).max() > 0.01
    zero = colours.tensors(dr.zeros(mi.Float, colours.count))
    assert (zero["colour_matrix"] == np.eye(3)).all() and (zero["colour_offset"] == 0).all()


def test_colours_and_gradients_are_those_of_the_map():
    colours, rng = CameraColours(3), np.random.default_rng(1)
    values = random_values(colours)
    dr.enable_grad(values)
    camera, colour, opacity = rng.integers(3, size=50), rng.uniform(size=(3, 50)), rng.uniform(size=50)
    weights = rng.normal(size=(3, 50))
    found = colours.seen(values, mi.UInt32(camera), mi.Color3f(colour), mi.Float(opacity))
    dr.backward(sum(dr.sum(mi.Float(weights[k]) * found[k]) for k in range(3)))

    def expected(values):
        z = values.reshape(3, 12)
        z = z - z.mean(0)
        matrix, offset = np.eye(3) + 0.1 * z[:, :9].reshape(3, 3, 3), 0.02 * z[:, 9:]
        return np.einsum("nij,jn->in", matrix[camera], colour) + offset[camera].T * opacity

    start = np.asarray(dr.detach(values), np.float64)
    np.testing.assert_allclose(np.asarray(dr.detach(found)), expected(start), atol=1e-6)
    # It is linear, so that any step will do.
    gradient = [(weights * (expected(start + s) - expected(start))).sum() for s in np.eye(36)]
    np.testing.assert_allclose(dr.grad(values), gradient, rtol=1e-3, atol=1e-4)


def test_targets_are_undone_as_radiance_is_mapped():
    colours, rng = CameraColours(2), np.random.default_rng(2)
    values, background = random_values(colours), np.array([0.2, 0.3, 0.4], np.float32)
    camera, mask = rng.integers(2, size=40), rng.uniform(size=40)
    linear = mask * rng.uniform(0.2, 0.6, (3, 40))
    behind = (1 - mask) * srgb_to_linear(background)[:, None]
    seen = np.asarray(colours.seen(values, mi.UInt32(camera), mi.Color3f(linear), mi.Float(mask)))
    found = colours.unseen(values, camera, linear_to_srgb(seen + behind), mask, background)
    np.testing.assert_allclose(found, linear_to_srgb(linear + behind), atol=1e-5)


def test_a_known_white_balance_is_found():
    """Points of unknown colour, which three cameras see with different white balance."""
    gains = np.array([[1.2, 1.0, 0.8], [0.9, 1.0, 1.15], [0.9, 1.0, 1.05]])
    colours, rng = CameraColours(3), np.random.default_rng(3)
    points = rng.uniform(0.1, 0.7, (3, 200))
    target = mi.Color3f(np.concatenate([gain[:, None] * points for gain in gains], 1))
    lane = dr.arange(mi.UInt32, 600)
    camera, point = lane // 200, lane % 200
    groups = {"colours": (0.05, dr.zeros(mi.Float, colours.count)), "points": (0.02, mi.Float([0.4] * 600))}
    optimisers = {name: mi.ad.Adam(lr=rate, params={name: value}) for name, (rate, value) in groups.items()}
    for step in range(300):
        own = dr.gather(mi.Color3f, optimisers["points"]["points"], point)
        error = colours.seen(optimisers["colours"]["colours"], camera, own, mi.Float(1.0)) - target
        dr.backward(dr.mean(dr.squared_norm(error)))
        for name, optimiser in optimisers.items():
            optimiser.set_learning_rate(groups[name][0] * 0.1 ** (step / 300))
            optimiser.step()
    tensors = colours.tensors(optimisers["colours"]["colours"])
    found = np.einsum("nij,jp->nip", tensors["colour_matrix"], points) + tensors["colour_offset"][..., None]
    np.testing.assert_allclose(found, (gains / gains.mean(0))[..., None] * points, atol=0.01)


def test_cameras_of_the_run_are_given_their_maps(capture, tmp_path):
    options = TrainingOptions(surface="body", steps=10, camera_colours=True, held_back=0.0)
    trainer = start(tmp_path / "run", capture, preset("tiny"), options)
    values = random_values(CameraColours(4))
    trainer.refinement.publish(Corrections(colours=values))
    linear, opacity = np.full((2, 2, 3), 0.3), np.full((2, 2), 0.8)
    found = seen_by(trainer.run, capture.cameras["c2"], linear, opacity)
    expected = CameraColours(4).seen(values, mi.UInt32([2]), mi.Color3f(0.3), mi.Float(0.8))
    np.testing.assert_allclose(found[1, 1], np.asarray(expected)[:, 0], atol=1e-6)
    assert seen_by(trainer.run, capture.cameras["n0"], linear, opacity) is linear


def test_one_camera_has_nothing_to_be_compared_with(capture, tmp_path):
    single = with_training_cameras(capture, "c0")
    with pytest.raises(InputError, match="1 training camera"):
        start(tmp_path / "run", single, preset("tiny"), TrainingOptions(surface="body", camera_colours=True))
