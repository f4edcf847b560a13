"""The best model is kept: while training diverges, through checkpoints, and what a run records of it."""

import dataclasses
import json

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.best import Best
from ndf_mi.learn.loop import resume, start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run

TINY = dataclasses.replace(preset("tiny"), band_inside=0.08)
OPTIONS = TrainingOptions(steps=150, rays=128, samples=24, seed=4, held_back=0.25, decay=1.0,
                          learning_rate=1e-2, grid_rate=5e-2)


def rows_of(run):
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]


def views_drawn(trainer, steps=40):
    """(frame, camera) of the rays that the trainer's sampler draws."""
    rng = np.random.default_rng(0)
    batches = [trainer.batches(rng, False, False) for _ in range(steps)]
    return {(batch.frame, int(camera)) for batch in batches for camera in set(batch.camera)}


def test_the_best_is_published_when_training_diverges_afterwards(capture, tmp_path):
    trainer = start(tmp_path / "run", capture, TINY, dataclasses.replace(OPTIONS, held_back_until=1.0))
    draw = trainer.batches

    def diverging(*arguments):
        if trainer.progress.step == 100:
            trainer.options = dataclasses.replace(trainer.options, learning_rate=1.0, grid_rate=5.0)
        return draw(*arguments)

    trainer.batches = diverging
    train(trainer, quiet=True)
    curve = {row["step"]: row["held_back_psnr"] for row in rows_of(tmp_path / "run")}
    assert list(curve) == [50, 100, 150] and curve[150] < curve[100] - 3 and curve[50] < curve[100]
    run = Run.load(tmp_path / "run")
    assert run.config["trained"]["kept"] == {"step": 100, "held_back_psnr": curve[100]}
    now = trainer.progress
    assert (now.kept_step, now.held_back_step, now.step) == (100, 150, 150)
    # What was published has the error that was measured, the last parameters have another.
    error = trainer._held_back.error(trainer._quadrature.image_error, run.parameters)
    assert -10 * np.log10(error) == pytest.approx(curve[100], abs=1e-3)
    np.testing.assert_array_equal(run.parameters.arrays()["weights"],
                                  trainer.run.parameters.arrays()["weights"])
    assert np.abs(run.parameters.arrays()["weights"] - trainer.parameters.arrays()["weights"]).max() > 0.1


def test_the_best_survives_a_checkpoint(capture, tmp_path):
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    for _ in range(60):
        trainer.step()
    trainer.save()
    again = resume(tmp_path / "run", capture)
    assert again.progress == dataclasses.replace(trainer.progress, evaluated=0)
    assert again.progress.kept_step == 50
    for name, values in trainer.run.parameters.arrays().items():
        np.testing.assert_array_equal(again.run.parameters.arrays()[name], values)
    for name, values in trainer.parameters.arrays().items():
        np.testing.assert_array_equal(again.parameters.arrays()[name], values)
        assert (again.run.parameters.arrays()[name] != values).any()


def test_views_are_trained_on_at_last_if_training_does_no_harm(capture, tmp_path):
    """At two thirds, where the error is the least so far; a checkpoint remembers it."""
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    while trainer.progress.step < 99:
        trainer.step()
    assert len(views_drawn(trainer)) == 6 and trainer.progress.kept_step == 50
    trainer.step()
    assert len(views_drawn(trainer)) == 8
    now = trainer.progress
    assert now.kept_step is None and now.held_back_step == 100 and now.held_back_psnr is not None
    trainer.save()
    again = resume(tmp_path / "run", capture)
    assert again.progress.released and len(views_drawn(again)) == 8
    train(again, quiet=True)
    assert again.progress.held_back_step == 100
    run = Run.load(tmp_path / "run")
    assert run.config["trained"]["all_views_from"] == 100 and "kept" not in run.config["trained"]
    np.testing.assert_array_equal(run.parameters.arrays()["weights"], again.parameters.arrays()["weights"])


def test_views_stay_held_back_where_training_does_harm(capture, tmp_path):
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    while trainer.progress.step < 50:
        trainer.step()
    trainer._best.error /= 100
    while trainer.done < 1:
        trainer.step()
    assert trainer.progress.kept_step == 50 and len(views_drawn(trainer)) == 6


def test_refused_steps_leave_the_best_alone(capture, tmp_path, poison):
    """The optimisers return to a snapshot from before the best was measured."""
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    poison(trainer, range(53, 56))
    while trainer.progress.step < 52:
        trainer.step()
    trainer.publish()
    before = trainer.run.parameters.arrays()
    while trainer.progress.step < 56:
        trainer.step()
    trainer.publish()
    now = trainer.progress
    assert (now.steps_refused, now.kept_step, now.held_back_step) == (3, 50, 50)
    for name, values in before.items():
        np.testing.assert_array_equal(trainer.run.parameters.arrays()[name], values)


def test_moments_follow_the_clock(capture, tmp_path):
    options = dataclasses.replace(OPTIONS, seconds=300.0, steps=10**9)
    trainer = start(tmp_path / "run", capture, TINY, options)
    for taken, seconds, measured in ((50, 5.0, 0), (100, 10.0, 100), (130, 20.5, 100), (150, 20.5, 150),
                                     (151, 300.0, 151)):
        trainer._taken, trainer._seconds = taken, seconds
        trainer._measure_held_back()
        assert trainer.progress.held_back_step == measured


def test_the_step_that_ends_the_time_is_measured(capture, tmp_path):
    options = dataclasses.replace(OPTIONS, seconds=300.0, steps=10**9)
    trainer = start(tmp_path / "run", capture, TINY, options)
    trainer.step()
    trainer._seconds = 300 - 1e-6
    trainer.step()
    now = trainer.progress
    assert trainer.done == 1 and now.step == now.held_back_step == 2 and now.seconds > 300


def test_nothing_is_kept_without_held_back_views(capture, tmp_path):
    options = dataclasses.replace(OPTIONS, steps=2, held_back=0.0)
    trainer = start(tmp_path / "run", capture, TINY, options)
    train(trainer, quiet=True)
    assert trainer.progress.kept_step is None and trainer.progress.held_back_psnr is None
    assert "kept" not in Run.load(tmp_path / "run").config["trained"]
    assert "held_back_psnr" not in rows_of(tmp_path / "run")[-1]


class Optimiser(dict):
    """Stands for an optimiser: its parameters by key."""


def test_only_less_error_replaces_the_best():
    import mitsuba as mi

    best, optimisers = Best(), {"weights": Optimiser(weights=mi.Float(1.0, 2.0))}
    best.observe(50, 0.1, float("nan"), optimisers)
    assert not best.parameters
    for step, error in ((100, 0.5), (150, 0.6), (200, float("nan")), (250, float("inf"))):
        best.observe(step, step / 1000, error, optimisers)
        optimisers["weights"]["weights"] = mi.Float(step, step)
    assert (best.step, best.error, best.last_step) == (100, 0.5, 250)
    assert list(best.parameters["weights"]["weights"]) == [1, 2]
    same = Best()
    same.restore(best.tensors(), json.loads(json.dumps(best.metadata())), optimisers, "here")
    assert (same.step, same.error, same.last_done) == (100, 0.5, 0.25)
    with pytest.raises(InputError, match=r"best\.weights\.weights"):
        same.restore({}, best.metadata(), optimisers, "here")
