"""A step that would ruin the parameters is refused: training returns to a good state and continues, or
stops."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn import guard
from ndf_mi.learn.loop import resume, start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run

OPTIONS = TrainingOptions(surface="body", steps=12, rays=128, samples=16, seed=4)
TINY = dataclasses.replace(preset("tiny"), band_inside=0.08)


def parameters(trainer):
    return {key: value.copy() for key, value in trainer.parameters.arrays().items()}


def test_a_poisoned_step_is_refused(capture, tmp_path, poison, monkeypatch, capsys):
    monkeypatch.setattr(guard, "KEEP_EVERY", 2)
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    poison(trainer, {6, 9})
    after = []
    for _ in range(6):
        trainer.step()
        after.append(parameters(trainer))
    # The sixth returns to the snapshot from which the fifth started.
    progress = trainer.progress
    assert (progress.step, progress.steps_refused, progress.rate_factor) == (5, 1, 0.5)
    for key, value in after[5].items():
        assert (value == after[3][key]).all() and (value != after[4][key]).any()
    train(trainer, quiet=True)
    assert trainer.progress.step == 12 and trainer.progress.rate_factor == 0.25
    assert "step 8" in capsys.readouterr().out
    assert all(np.isfinite(value).all() for value in Run.load(tmp_path / "run").field_tensors().values())
    again = resume(tmp_path / "run", capture).progress
    assert again.rate_factor == 0.25 and again.steps_refused == 2
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert (rows[-1]["refused"], rows[-1]["rate_factor"]) == (2, 0.25)


def test_training_stops_where_smaller_steps_do_not_help(capture, tmp_path, poison, monkeypatch):
    """It saves the last good state, from which it can be resumed."""
    monkeypatch.setattr(guard, "KEEP_EVERY", 2)
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    poison(trainer, range(4, 100))
    for _ in range(2):
        trainer.step()
    good = parameters(trainer)
    with pytest.raises(InputError) as caught:
        train(trainer, quiet=True)
    for fact in ("step 4", "learning_rate", "--resume", str(tmp_path / "run")):
        assert fact in str(caught.value)
    assert trainer.progress.steps_refused == guard.PATIENCE + 1
    saved = Run.load(tmp_path / "run")
    assert saved.config["trained"]["steps"] == 3 and not saved.config["trained"]["done"]
    for key, value in good.items():
        assert (saved.field_tensors()[key] == value).all()
    again = resume(tmp_path / "run", capture)
    assert again.progress.step == 3 and again.progress.rate_factor == 0.5**guard.PATIENCE
    for key, value in parameters(again).items():
        assert (good[key] == value).all()
    train(again, quiet=True)
    assert again.progress.step == 12 and Run.load(tmp_path / "run").config["trained"]["done"]


@pytest.mark.parametrize("rate", [1e-30, 1e30])
def test_extreme_learning_rates_leave_finite_parameters(capture, tmp_path, rate):
    """Steps of 1e30 overflow at once, and halving does not help; steps of 1e-30 are lost to rounding, except
    from 0."""
    trainer = start(tmp_path / "run", capture, TINY,
                    dataclasses.replace(OPTIONS, learning_rate=rate, grid_rate=rate))
    before = parameters(trainer)
    if rate == 1e30:
        with pytest.raises(InputError, match="learning_rate"):
            train(trainer, quiet=True)
    else:
        train(trainer, quiet=True)
        for key, value in parameters(trainer).items():
            assert np.where(before[key] == 0, np.abs(value) < 1e-27, value == before[key]).all()
    assert all(np.isfinite(value).all() for value in parameters(trainer).values())
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert all(np.isfinite(row["loss"]) for row in rows)
