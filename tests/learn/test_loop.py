"""Whole trainings: they learn, resume exactly where they stopped, compile nothing once warm, and refuse bad
input."""

import dataclasses
import json
import signal

import drjit as dr
import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.loop import resume, start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.render.image import ImageRenderer
from ndf_mi.run import Run

OPTIONS = TrainingOptions(surface="body", steps=60, rays=256, samples=24, seed=4)
TINY = dataclasses.replace(preset("tiny"), band_inside=0.08)


def taken(trainer, steps):
    for _ in range(steps):
        trainer.step()
    return trainer


def assert_same_parameters(one, other):
    """Equal except for the order in which threads add up the hash table's gradients."""
    for key, value in one.parameters.arrays().items():
        np.testing.assert_allclose(other.parameters.arrays()[key], value, rtol=0,
                                   atol=2e-4 * np.abs(value).max())


@pytest.fixture(scope="module")
def whole(capture, tmp_path_factory):
    """A training of 12 steps without interruption."""
    options = dataclasses.replace(OPTIONS, steps=12)
    return taken(start(tmp_path_factory.mktemp("whole") / "run", capture, TINY, options), 12)


def test_training_learns_and_writes_a_run(capture, tmp_path):
    options = dataclasses.replace(OPTIONS, steps=200, learning_rate=1e-2, grid_rate=5e-2)
    trainer = start(tmp_path / "run", capture, TINY, options)
    camera, frame = "n0", capture.splits["novel_view"].frames[0]
    fog = ImageRenderer(64)(trainer.run.posed(frame), capture.cameras[camera]).over(trainer.run.background)
    train(trainer, quiet=True)
    run = Run.load(tmp_path / "run")
    image = ImageRenderer(64)(run.posed(frame), capture.cameras[camera]).over(run.background)
    truth = capture.image(camera, frame)
    mask = capture.mask(camera, frame)
    assert np.square(image - truth)[mask].mean() < 0.5 * np.square(truth[mask] - truth[mask].mean(0)).mean()
    # The initial fog is gone off the outline, which so few steps leave blurred.
    far = ~binary_dilation(mask, iterations=2)
    assert np.square(image - truth)[far].mean() < 0.5 * np.square(fog - truth)[far].mean()
    rows = [json.loads(line) for line in (run.path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [50, 100, 150, 200] and rows[-1]["psnr"] > rows[0]["psnr"]
    # Most of the box's pixels are background, which is learned first.
    assert rows[-1]["box_psnr"] > rows[-1]["psnr"]
    assert run.config["trained"]["steps"] == 200 and run.config["trained"]["done"]
    assert list(run.path.glob("events*"))


def test_a_killed_training_ends_at_the_parameters_of_an_uninterrupted_one(capture, tmp_path, whole):
    half = taken(start(tmp_path / "half", capture, TINY, whole.options), 7)
    half.save()
    taken(half, 2)  # steps that are lost when the process is killed
    again = taken(resume(tmp_path / "half", capture), 5)
    assert again.progress.step == 12
    assert_same_parameters(whole, again)
    other = start(tmp_path / "other", capture, TINY, dataclasses.replace(OPTIONS, seed=5)).parameters.arrays()
    assert np.abs(other["weights"] - whole.parameters.arrays()["weights"]).max() > 0.01


def test_nothing_is_compiled_once_warm(capture, tmp_path):
    trainer = taken(start(tmp_path / "run", capture, TINY, OPTIONS), 12)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        taken(trainer, 25)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert len(history) > 100
    assert [kernel["size"] for kernel in history if not kernel["cache_hit"]] == []


def test_a_run_is_not_overwritten_and_belongs_to_its_capture(capture, write_capture, tmp_path):
    start(tmp_path / "run", capture, TINY, OPTIONS)
    with pytest.raises(InputError, match="--resume"):
        start(tmp_path / "run", capture, TINY, OPTIONS)
    with pytest.raises(InputError, match="other"):
        resume(tmp_path / "run", Capture.read(write_capture("other")))
    with pytest.raises(InputError, match="config.json"):
        resume(tmp_path / "nothing", capture)


@pytest.fixture(scope="module")
def saved(capture, tmp_path_factory):
    """The folder of a run that was saved after a step."""
    trainer = taken(start(tmp_path_factory.mktemp("saved") / "run", capture, TINY, OPTIONS), 1)
    trainer.save()
    return trainer.run.path


@pytest.mark.parametrize(("file", "change", "fact"), [
    ("field.safetensors", lambda data: data[:1000], "field.safetensors"),
    ("state.safetensors", lambda data: b"nonsense", "state.safetensors"),
    ("config.json", lambda data: changed(data, version=2), "version"),
    ("config.json", lambda data: changed(data, training=None), "training"),
    ("config.json", lambda data: changed(data, preset=json.loads(data)["preset"] | {"colour_of_sky": 1}),
     "colour_of_sky"),
])
def test_damaged_runs_are_refused_by_name(capture, saved, file, change, fact):
    whole = (saved / file).read_bytes()
    (saved / file).write_bytes(change(whole))
    try:
        with pytest.raises(InputError, match=fact):
            resume(saved, capture)
    finally:
        (saved / file).write_bytes(whole)


def changed(data, **entries):
    return json.dumps(json.loads(data) | entries).encode()


def test_a_run_without_its_state_cannot_be_resumed(capture, tmp_path):
    train(start(tmp_path / "run", capture, TINY, dataclasses.replace(OPTIONS, steps=2)), quiet=True)
    (tmp_path / "run" / "state.safetensors").unlink()
    with pytest.raises(InputError, match="state.safetensors"):
        resume(tmp_path / "run", capture)


def test_an_interrupt_finishes_the_step_and_saves_the_state(capture, tmp_path, whole):
    trainer = start(tmp_path / "run", capture, TINY, whole.options)
    draw = trainer.batches

    def interrupted(*arguments):
        if trainer.progress.step == 5:
            signal.raise_signal(signal.SIGINT)
        return draw(*arguments)

    trainer.batches = interrupted
    with pytest.raises(KeyboardInterrupt):
        train(trainer, quiet=True)
    assert trainer.progress.step == 6
    assert not json.loads((tmp_path / "run" / "config.json").read_text())["trained"]["done"]
    again = resume(tmp_path / "run", capture)
    assert again.progress.step == 6
    train(again, quiet=True)
    assert again.progress.step == 12
    assert_same_parameters(whole, again)


def test_a_training_that_diverges_returns_to_the_last_snapshot(capture, tmp_path, poison):
    """Here the first: snapshots are far apart, and any step since may have led astray."""
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    first = (tmp_path / "run" / "field.safetensors").read_bytes()
    taken(trainer, 2).save()
    assert (tmp_path / "run" / "field.safetensors").read_bytes() != first
    poison(trainer, range(1, 100))
    with pytest.raises(InputError, match="learning_rate"):
        train(trainer, quiet=True)
    assert (tmp_path / "run" / "field.safetensors").read_bytes() == first
    assert resume(tmp_path / "run", capture).progress.step == 2
