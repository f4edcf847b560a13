"""The neural field as a method."""

from __future__ import annotations

import json
import signal

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.methods.base import Budget
from ndf_mi.methods.ndf import NeuralField


@pytest.fixture(scope="module")
def field(trained_run, capture) -> NeuralField:
    method = NeuralField(samples=16)
    method.load(trained_run.path, capture)
    return method


def test_its_metadata_describes_the_training(field, capture):
    known = field.metadata()
    assert (
        known["steps"] == 60
        and known["seconds"] > 0
        and known["capture"] == capture.digest
        and known["samples"] == 16
    )
    assert [entry[0] for entry in known["history"]] == [50, 60] and all(
        len(entry) == 3 for entry in known["history"]
    )
    assert known["held_back"] == [] and known["kept_step"] is None
    json.dumps(known, allow_nan=False)


def test_its_metadata_has_the_curve_of_held_back_views(trained_run, capture, tmp_path):
    method = NeuralField.of(trained_run, 16)
    method.save(tmp_path / "copy")
    config = json.loads((tmp_path / "copy" / "config.json").read_text())
    config["trained"]["kept"] = {"step": 50, "held_back_psnr": 20.5}
    (tmp_path / "copy" / "config.json").write_text(json.dumps(config))
    with open(tmp_path / "copy" / "metrics.jsonl", "a") as log:
        log.write(json.dumps({"step": 60, "seconds": 3.0, "held_back_psnr": 20.5}) + "\n")
    again = NeuralField(16)
    again.load(tmp_path / "copy", capture)
    assert again.metadata()["held_back"] == [[60, 3.0, 20.5]] and again.metadata()["kept_step"] == 50


def test_its_cache_key_depends_on_what_is_rendered(field, trained_run):
    assert (
        field.cache_key()
        == NeuralField.of(trained_run, 16).cache_key()
        != NeuralField.of(trained_run, 8).cache_key()
    )


def test_saved_and_loaded_it_renders_the_same(field, capture, tmp_path):
    field.save(tmp_path / "copy")
    again = NeuralField(samples=16)
    again.load(tmp_path / "copy", capture)
    camera = capture.cameras["n0"].scaled(12, 12)
    np.testing.assert_array_equal(again.render(camera, 7), field.render(camera, 7))
    assert again.metadata() == field.metadata() and again.cache_key() == field.cache_key()


def test_runs_of_another_capture_or_through_scattering_are_refused(
    trained_run, capture, write_capture, field, tmp_path
):
    from ndf_mi.capture.capture import Capture

    with pytest.raises(InputError, match="digest"):
        NeuralField().load(trained_run.path, Capture.read(write_capture("other")))
    field.save(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    config["training"]["integrator"] = "prbvolpath"
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputError, match="training.integrator.*prbvolpath"):
        NeuralField().load(tmp_path, capture)


def test_a_stopped_training_continues_where_it_will_be_saved(capture, tmp_path):
    seen: list[int] = []

    def stop(seconds, step, loss):
        seen.append(step)
        assert seconds > 0 and 0 < loss < 1
        if step == 2:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        NeuralField(samples=8, preset="tiny").fit_in(tmp_path, capture, Budget(seconds=3.0, seed=2), stop)
    method = NeuralField(samples=8, preset="tiny")
    method.fit_in(tmp_path, capture, Budget(seconds=3.0, seed=2), stop)
    assert seen[:3] == [1, 2, 3] and method.metadata()["seconds"] >= 3
    method.fit_in(tmp_path, capture, Budget(seconds=3.0, seed=2), stop)  # trained already
    assert seen.count(3) == 1
    again = NeuralField(samples=8, preset="tiny")
    again.load(tmp_path, capture)
    assert again.cache_key() == method.cache_key()
    seen.clear()
    again.fit_in(
        tmp_path, capture, Budget(seconds=0.1, seed=3), lambda seconds, step, loss: seen.append(step)
    )
    assert seen[0] == 1 and again.metadata()["seed"] == 3


@pytest.mark.long
def test_it_trains_for_the_time_given(capture):
    method = NeuralField(samples=8, preset="tiny")
    method.fit(capture, Budget(seconds=3.0, seed=2))
    known = method.metadata()
    assert known["seed"] == 2 and known["steps"] > 1 and 3 <= known["seconds"] < 30
    assert method.render(capture.cameras["n0"].scaled(8, 8), 2).shape == (8, 8, 3)
