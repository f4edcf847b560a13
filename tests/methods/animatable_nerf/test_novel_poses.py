"""Blend weights at poses without images, learnt from their agreement with the canonical ones."""

from __future__ import annotations

import dataclasses

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.methods.animatable_nerf.architecture import FAST
from ndf_mi.methods.animatable_nerf.novel_poses import NovelPoses, from_rest, from_world
from ndf_mi.methods.animatable_nerf.volume import AnimatableNerfVolume
from ndf_mi.methods.volume.optimisation import Optimisation, Schedule

#: Everything is dense, so that all points around the body count.
SHAPE = dataclasses.replace(FAST, agree_above=-1.0, novel_points=4096)


@pytest.fixture(scope="module")
def volume(limb_capture: Capture) -> AnimatableNerfVolume:
    return AnimatableNerfVolume(limb_capture, SHAPE)


@pytest.fixture(scope="module")
def parameters(volume: AnimatableNerfVolume) -> dict[str, mi.Float]:
    """Untrained, but for canonical blend weights that differ from the body's."""
    found = volume.initial(np.random.default_rng(0))
    found["blend"] *= 2
    return {name: mi.Float(value) for name, value in found.items()}


def test_weights_of_both_spaces_come_to_agree_without_images(limb_capture, volume, parameters,
                                                             monkeypatch) -> None:
    def unexpected(*_: object) -> None:
        pytest.fail("an image was read")

    for name in ("image", "matte", "mask"):
        monkeypatch.setattr(Capture, name, unexpected)
    before = {name: value.numpy() for name, value in parameters.items()}
    stage = NovelPoses(volume)
    assert volume.untrained == [5, 6] and "2 frames" in stage.note
    training = Optimisation(stage.initial(np.random.default_rng(1)), stage.objective(parameters),
                            Schedule(60, 4e-3))
    unit = mi.Point3f(np.random.default_rng(2).random((3, 4096), dtype=np.float32))

    def disagreements() -> list[float]:
        posed = volume.at(6, {**parameters, **training.parameters})
        return [float(of(posed, unit)[0]) for of in (from_world, from_rest)]

    first = disagreements()
    for _ in range(60):
        training.step()
    now = disagreements()
    assert now[0] < 0.1 * first[0] and now[1] < 0.5 * first[1]
    for name, value in parameters.items():
        np.testing.assert_array_equal(value.numpy(), before[name])
