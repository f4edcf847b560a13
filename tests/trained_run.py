"""A run trained for a few steps on the sphere."""

import dataclasses

import pytest

from ndf_mi.field import preset
from ndf_mi.learn.loop import start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run


@pytest.fixture(scope="session")
def trained_run(capture, tmp_path_factory) -> Run:
    options = TrainingOptions(steps=60, rays=256, samples=32, max_depth=3)
    # Colours that no view direction enters can be put onto a lattice.
    small = dataclasses.replace(preset("tiny"), grid_levels=2, direction_octaves=-1)
    trainer = start(tmp_path_factory.mktemp("trade") / "run", capture, small, options)
    train(trainer, quiet=True)
    return Run.load(trainer.run.path)
