"""Training on views, and on strips of large ones."""

from __future__ import annotations

import dataclasses

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.methods.gaussians import training
from ndf_mi.methods.gaussians.primitives import areas, initial
from ndf_mi.methods.gaussians.training import (
    NETWORK,
    SHADE,
    Settings,
    SplatOptimisation,
    Splats,
    ViewObjective,
)

SETTINGS = Settings(spacing=3.0)


def test_a_step_on_strips_has_the_error_of_the_whole_views(capture, monkeypatch):
    splats = Splats.for_capture(capture, SETTINGS)
    binding = splats.spread(np.random.default_rng(0))
    objective = ViewObjective(capture, splats, binding, dataclasses.replace(SETTINGS, pose_noise=0.0))
    learned = initial(len(binding), objective.mean_colour(), np.random.default_rng(0))
    parameters = {name: mi.Float(value.ravel()) for name, value in learned.items()}
    parameters[SHADE] = mi.Float([0.0] * 24)
    parameters[NETWORK] = mi.Float(splats.network.initial(np.random.default_rng(0)))

    def mean_error(draws: int) -> float:
        rng = np.random.default_rng(1)
        return float(np.mean([objective(parameters, rng).error.numpy() for _ in range(draws)]))

    whole = mean_error(30)
    monkeypatch.setattr(training, "PIXELS", 600)
    strips = mean_error(60)
    # Rows at the top and bottom, which show the background, are drawn less often.
    assert strips == pytest.approx(whole, rel=0.3) and strips != whole


def test_there_are_no_more_primitives_than_asked_for(capture):
    splats = Splats.for_capture(capture, dataclasses.replace(SETTINGS, first=50))
    assert len(splats.spread(np.random.default_rng(0))) == 50
    area = areas(capture.poses.vertices[0], capture.body.faces).sum()
    assert splats.spacing == pytest.approx(np.sqrt(area / 50))


def test_rounds_add_the_primitives_that_spacing_asks_for(capture):
    settings = dataclasses.replace(
        SETTINGS, first=300, rounds=3, most=350, densified=0.6,
        schedule=dataclasses.replace(SETTINGS.schedule, steps=10))
    splats = Splats.for_capture(capture, settings)
    objective = ViewObjective(capture, splats, splats.spread(np.random.default_rng(0)), settings)
    optimisation = SplatOptimisation(objective, settings, seed=1)
    counts = []
    for _ in range(10):
        optimisation.step()
        counts.append(len(optimisation.binding))
    assert counts == [300, 317, 317, 334, 334, 350, 350, 350, 350, 350] and optimisation.rounds == 3
    assert all(value.shape[1] == 350 for value in optimisation.learned.values())
