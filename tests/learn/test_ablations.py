"""Every ablation trains and reads back."""

import math

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.ablations import ABLATIONS, ablation
from ndf_mi.learn.loop import resume, start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run


@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_trains_and_reads_back(name, capture, tmp_path):
    short = TrainingOptions(surface="body", steps=2, rays=64, samples=16)
    options, training = ablation(name).apply(preset("tiny"), short)
    trainer = start(tmp_path / "run", capture, options, training)
    train(trainer, quiet=True)
    assert math.isfinite(trainer.progress.error)
    loaded = Run.load(tmp_path / "run")
    assert loaded.model.field.preset == options
    np.testing.assert_array_equal(loaded.parameters.weights.numpy(), trainer.parameters.weights.numpy())
    assert resume(tmp_path / "run", capture).progress.step == 2
    x = mi.Point3f(loaded.poses.vertices[0, :50].T)
    d = mi.Vector3f(0, 0, 1) + 0 * mi.Vector3f(x)
    posed = loaded.posed(int(loaded.poses.frames[0]))
    located = posed.locate(x, mi.Bool(True))
    assert located.valid.numpy().any()
    assert np.isfinite(posed.evaluate(x, d, located, located.valid).sigma.numpy()).all()


def test_each_is_a_change():
    full = ablation("full").apply(preset("fast"), TrainingOptions())
    others = [ablation(name).apply(preset("fast"), TrainingOptions()) for name in ABLATIONS if name != "full"]
    assert full == (preset("fast"), TrainingOptions()) and all(other != full for other in others)
    with pytest.raises(InputError, match="no-pose"):
        ablation("no-light")
