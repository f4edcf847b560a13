"""The field around a posed limb: where it is, and that it follows the skin."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.methods.animatable_nerf.architecture import FAST
from ndf_mi.methods.animatable_nerf.field import mean_disagreement
from ndf_mi.methods.animatable_nerf.volume import AnimatableNerfVolume


@pytest.fixture(scope="module")
def volume(limb_capture: Capture) -> AnimatableNerfVolume:
    return AnimatableNerfVolume(limb_capture, dataclasses.replace(FAST, agree_above=-1.0))


@pytest.fixture(scope="module")
def parameters(volume: AnimatableNerfVolume) -> dict[str, mi.Float]:
    """Dense enough to see, with the body's own blend weights: no correction in world space."""
    found = volume.initial(np.random.default_rng(0)) | volume.initial_novel(np.random.default_rng(1))
    found["grid"] = 0.5 * np.random.default_rng(2).standard_normal(found["grid"].size).astype(np.float32)
    for name in ("blend", "novel"):
        found[name] = np.zeros_like(found[name])
    return {name: mi.Float(value) for name, value in found.items()}


def evaluated(volume: AnimatableNerfVolume, frame: int, points: np.ndarray, parameters: dict[str, mi.Float]):
    posed = volume.at(frame, parameters)
    x = mi.Point3f(np.ascontiguousarray(points.T, np.float32))
    located = posed.locate(x, mi.Bool(True))
    d = dr.zeros(mi.Vector3f, len(points)) + mi.Vector3f(0, 0, 1)
    sample = posed.evaluate(x, d, located, mi.Bool(True))
    density = posed.density(x, located, mi.Bool(True))
    np.testing.assert_allclose(density.numpy(), sample.sigma.numpy(), rtol=2e-3, atol=1e-3)
    return sample


def test_the_field_follows_the_skin(limb_capture, volume, parameters) -> None:
    """Vertices are carried to the same canonical places at all poses, with images or without."""
    poses = limb_capture.poses
    sigma = [evaluated(volume, frame, poses.vertices[poses.index(frame)], parameters).sigma.numpy()
             for frame in (0, 2, 5, 6)]
    assert sigma[0].std() > 0.05
    for other in sigma[1:]:
        np.testing.assert_allclose(other, sigma[0], rtol=2e-2, atol=2e-2)


def test_there_is_nothing_out_of_reach(volume, parameters) -> None:
    # At frame 0 the limb stands around the origin, and its radius there is 0.2 m.
    points = np.array([[0.22, 0, 0], [0.18, 0, 0], [0.28, 0, 0], [0, 0, 0]])
    sigma = evaluated(volume, 0, points, parameters).sigma.numpy()
    assert (sigma > 0).tolist() == [True, True, False, False]
    assert not volume.at(0, parameters).may_contain(mi.Point3f(9, 9, 9)).numpy()[0]


def test_a_frame_without_images_has_the_last_frame_s_colours(limb_capture, volume, parameters) -> None:
    poses = limb_capture.poses
    colours = [evaluated(volume, frame, poses.vertices[poses.index(frame)], parameters).colour.numpy()
               for frame in (1, 2, 6)]
    np.testing.assert_allclose(colours[2], colours[1], atol=0.02)
    assert np.abs(colours[0] - colours[1]).max() > 0.05


def test_gradients_reach_every_tensor_of_training(limb_capture, volume, parameters) -> None:
    attached = {name: mi.Float(value) for name, value in parameters.items() if "novel" not in name}
    rng = np.random.default_rng(3)
    attached["blend"] = mi.Float((0.2 * rng.standard_normal(attached["blend"].shape)).astype(np.float32))
    dr.enable_grad(*attached.values())
    poses = limb_capture.poses
    posed = volume.at(1, attached)
    x = mi.Point3f(np.ascontiguousarray(poses.vertices[poses.index(1)].T))
    count = dr.width(x)
    located = posed.locate(x, mi.Bool(True))
    sample = posed.evaluate(x, dr.zeros(mi.Vector3f, count) + mi.Vector3f(0, 0, 1), located,
                            dr.full(mi.Bool, True, count))
    dr.backward(mean_disagreement(sample.disagreement, sample.counts) + dr.mean(sample.sigma)
                + dr.mean(sample.colour.x))
    for name, value in attached.items():
        gradient = dr.grad(value).numpy()
        assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0, name
    rows = dr.grad(attached["blend_codes"]).numpy().reshape(4, -1)
    # Those of the canonical space and of this frame.
    assert (np.abs(rows).max(axis=1) > 0).tolist() == [True, False, True, False]


def test_mean_disagreement_without_points_is_zero() -> None:
    assert mean_disagreement(mi.Float([1, 2, 4]), mi.Bool([True, False, True])).numpy()[0] == 2.5
    assert mean_disagreement(mi.Float([1, 2]), mi.Bool([False, False])).numpy()[0] == 0


def test_a_body_without_a_skinning_model_is_refused(capture: Capture) -> None:
    with pytest.raises(InputError, match="body.npz.*without joints"):
        AnimatableNerfVolume(capture, dataclasses.replace(FAST))
