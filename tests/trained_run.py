"""A run that was trained for a few steps on the sphere."""

from __future__ import annotations

import dataclasses

import pytest

from ndf_mi.field import preset
from ndf_mi.learn.loop import start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run


@pytest.fixture(scope="session")
def trained_run(capture, tmp_path_factory) -> Run:
    """Its colours do not depend on the view direction, so that it can be put onto a grid."""
    options = TrainingOptions(surface="body", steps=60, rays=256, samples=32, max_depth=3)
    small = dataclasses.replace(preset("tiny"), grid_levels=2, direction_octaves=-1)
    trainer = start(tmp_path_factory.mktemp("trained") / "run", capture, small, options)
    train(trainer, quiet=True)
    return Run.load(trainer.run.path)
