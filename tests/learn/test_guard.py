"""Steps that would ruin a training are not taken: it goes back, goes on more slowly, and says so or stops."""

from __future__ import annotations

import dataclasses
import json

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn import guard
from ndf_mi.learn.loop import resume, start, train
from ndf_mi.learn.loss import ImageLoss, Loss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run

OPTIONS = TrainingOptions(steps=12, rays=128, samples=16, seed=4)
TINY = dataclasses.replace(preset("tiny"), band_inside=0.08)


@pytest.fixture
def poisoned(monkeypatch):
    """Makes the loss of the steps, counted from 1 over all calls, not a number; a list to fill."""
    steps: list[int] = []
    count = [0]
    honest = ImageLoss.__call__

    def loss(self, seen, *truth):
        count[0] += 1
        found = honest(self, seen, *truth)
        return Loss(found.total * mi.Float(float("nan")), found.image) if count[0] in steps else found

    monkeypatch.setattr(ImageLoss, "__call__", loss)
    return steps


def weights(trainer):
    trainer.publish()
    return {key: value.copy() for key, value in trainer.run.field_tensors().items()}


def test_a_poisoned_step_is_not_taken(capture, tmp_path, poisoned, monkeypatch, capsys):
    monkeypatch.setattr(guard, "KEEP_EVERY", 2)
    poisoned.append(6)
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    after = []
    for _ in range(6):
        trainer.step()
        after.append(weights(trainer))
    # The sixth goes back to where the fifth started.
    assert trainer.progress.step == 5 and trainer.progress.refused == 1 and trainer.progress.rate_factor == 0.5
    for key, value in after[5].items():
        assert (value == after[3][key]).all() and (value != after[4][key]).any()
    poisoned.append(9)
    train(trainer, quiet=True)
    assert trainer.progress.step == 12 and trainer.progress.rate_factor == 0.25
    assert "step 8 is not taken" in capsys.readouterr().out
    assert all(np.isfinite(value).all() for value in Run.load(tmp_path / "run").field_tensors().values())
    again = resume(tmp_path / "run", capture).progress
    assert again.rate_factor == 0.25 and again.refused == 2
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert (rows[-1]["refused"], rows[-1]["rate_factor"]) == (2, 0.25)


def test_it_stops_where_smaller_steps_do_not_help(capture, tmp_path, poisoned, monkeypatch):
    """And keeps the state that it went back to last, from which it can be gone on."""
    monkeypatch.setattr(guard, "KEEP_EVERY", 2)
    poisoned.extend(range(4, 100))
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    for _ in range(2):
        trainer.step()
    good = weights(trainer)
    with pytest.raises(InputError, match="learning rate") as caught:
        train(trainer, quiet=True)
    assert "--resume" in str(caught.value) and str(tmp_path / "run") in str(caught.value)
    assert trainer.progress.refused == guard.PATIENCE + 1
    kept = Run.load(tmp_path / "run")
    assert kept.config["trained"]["steps"] == 3 and not kept.config["trained"]["done"]
    for key, value in good.items():
        assert (kept.field_tensors()[key] == value).all()
    poisoned.clear()
    again = resume(tmp_path / "run", capture)
    assert again.progress.step == 3 and again.progress.rate_factor == 0.5**guard.PATIENCE
    for key, value in weights(again).items():
        assert (good[key] == value).all()
    train(again, quiet=True)
    assert again.progress.step == 12 and Run.load(tmp_path / "run").config["trained"]["done"]


@pytest.mark.parametrize("rate", [1e-30, 1e-3, 1e30])
def test_any_learning_rate_leaves_finite_weights(capture, tmp_path, rate):
    """Steps of 1e30 overflow at once, and no halving helps; those of 1e-30 are lost to rounding, but for weights that start at 0."""
    trainer = start(tmp_path / "run", capture, TINY, dataclasses.replace(OPTIONS, learning_rate=rate, grid_rate=rate))
    before = weights(trainer)
    try:
        train(trainer, quiet=True)
    except InputError as error:
        assert rate == 1e30 and "learning rate" in str(error)
    after = weights(trainer)
    assert all(np.isfinite(value).all() for value in after.values())
    if rate == 1e-30:
        for key in before:
            assert np.where(before[key] == 0, np.abs(after[key]) < 1e-27, after[key] == before[key]).all()
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert all(np.isfinite(row["loss"]) for row in rows)
