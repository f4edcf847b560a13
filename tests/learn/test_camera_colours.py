"""Maps of colour: their mean is the identity, they are undone as they are applied, and a white balance is
found."""

import copy
import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.capture.document import Split
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.camera_colours import CameraColours
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


def test_a_known_white_balance_is_found(capture, tmp_path):
    gains = np.array([[1.2, 1.0, 0.8], [0.9, 1.0, 1.15], [0.9, 1.0, 1.05]])
    options = TrainingOptions(surface="body", steps=250, rays=256, samples=24, seed=4, held_back=0.0,
                              camera_colours=True, learning_rate=1e-2, grid_rate=5e-2, refine_after=50,
                              colour_rate=0.1, pose_noise=0.0)
    # Cameras that see much of the same side: others would have little to be compared by.
    capture = with_training_cameras(capture, "c0", "n0", "c1")
    # Without inputs that could explain one camera's colours.
    small = dataclasses.replace(preset("tiny"), band_inside=0.08, direction_octaves=-1, normal_octaves=-1)
    trainer = start(tmp_path / "run", capture, small, options)
    draw = trainer.batches
    background = srgb_to_linear(np.array(capture.background, np.float64))[:, None]

    def tinted(*args):
        batch = draw(*args)
        own = srgb_to_linear(batch.target.astype(np.float64)) - (1 - batch.mask) * background
        seen = gains[batch.camera].T * own + (1 - batch.mask) * background
        return dataclasses.replace(batch, target=linear_to_srgb(np.clip(seen, 0, 1)).astype(np.float32))

    trainer.batches = tinted
    for _ in range(250):
        trainer.step()
    trainer.publish()
    # Of the performer's own colours, which are all that the maps know.
    image, opaque = capture.image("n0", 2), np.ones((48, 48))
    linear = srgb_to_linear(image.astype(np.float64))
    mask = capture.mask("n0", 2)
    errors, before = [], []
    for name, gain in zip(("c0", "n0", "c1"), gains / gains.mean(0), strict=True):
        found = seen_by(trainer.run, capture.cameras[name], linear, opaque)
        print(name, (found[mask].mean(0) / linear[mask].mean(0)), gain)
        errors.append(np.abs(found - gain * linear)[mask].mean())
        before.append(np.abs(linear - gain * linear)[mask].mean())
    print(errors, before, trainer.progress)
    assert np.mean(errors) < 0.25 * np.mean(before)
    assert seen_by(trainer.run, capture.cameras["c2"], linear, opaque) is linear


def test_one_camera_has_nothing_to_be_compared_with(capture, tmp_path):
    single = with_training_cameras(capture, "c0")
    with pytest.raises(InputError, match="1 training camera"):
        start(tmp_path / "run", single, preset("tiny"), TrainingOptions(surface="body", camera_colours=True))
