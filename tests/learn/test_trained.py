"""Runs that are trained to their end: continued, restarted, and compared with the options asked for."""

from __future__ import annotations

import dataclasses

import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.loop import start
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.trained import clear, expect_options, is_trained, trained
from ndf_mi.run import Run

TINY = preset("tiny")
OPTIONS = TrainingOptions(surface="body", steps=4, rays=64, samples=8)


def test_a_training_is_started_continued_or_finished_already(capture, tmp_path):
    steps: list[int] = []

    def finish() -> Run:
        steps.clear()
        return trained(tmp_path, capture, TINY, OPTIONS, quiet=True,
                       progress=lambda seconds, step, error: steps.append(step))

    start(tmp_path, capture, TINY, OPTIONS)  # no checkpoint: begins again
    assert finish().config["trained"]["steps"] == 4 and steps == [1, 2, 3, 4] and is_trained(tmp_path)
    assert finish().config["trained"]["steps"] == 4 and steps == []
    clear(tmp_path)
    assert not is_trained(tmp_path)
    trainer = start(tmp_path, capture, TINY, OPTIONS)
    trainer.step()
    trainer.save()
    assert finish().config["trained"]["steps"] == 4 and steps == [2, 3, 4]


@pytest.mark.parametrize("products", [True, False])
def test_a_preset_field_that_older_runs_lack_is_compared(capture, tmp_path, products):
    with_, without = (
        dataclasses.replace(TINY, pose_products=value) for value in (products, not products)
    )
    run = start(tmp_path / "run", capture, with_, OPTIONS).run
    expect_options(run, capture, with_, OPTIONS)
    asked = f"pose_products = {products}; expected pose_products = {not products}"
    with pytest.raises(InputError, match=asked):
        expect_options(run, capture, without, OPTIONS)
