"""Training as a whole: it learns, goes on exactly where it stopped, compiles nothing once warm, and refuses what cannot be."""

import dataclasses
import json
import signal

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.loop import resume, start, train
from ndf_mi.learn.loss import ImageLoss, Loss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.rays import RaySampler
from ndf_mi.render.image import ImageRenderer
from ndf_mi.render.quadrature import Radiance
from ndf_mi.run import Run

OPTIONS = TrainingOptions(steps=60, rays=256, samples=24, seed=4)
TINY = dataclasses.replace(preset("tiny"), band_inside=0.08)


def taken(trainer, steps):
    for _ in range(steps):
        trainer.step()
    return trainer


def test_training_learns_and_writes_a_run(capture, tmp_path):
    trainer = start(tmp_path / "run", capture, TINY, dataclasses.replace(OPTIONS, steps=300, learning_rate=1e-2, grid_rate=5e-2))
    camera, frame = "n0", capture.splits["novel_view"].frames[0]
    fog = ImageRenderer(64)(trainer.run.posed(frame), capture.cameras[camera]).over(trainer.run.background)
    train(trainer, quiet=True)
    run = Run.load(tmp_path / "run")
    image = ImageRenderer(64)(run.posed(frame), capture.cameras[camera]).over(run.background)
    truth = capture.image(camera, frame)
    mask = capture.mask(camera, frame)
    assert np.square(image - truth)[mask].mean() < 0.5 * np.square(truth[mask] - truth[mask].mean(0)).mean()
    # Off the outline, which so few steps leave blurred, the fog that the field starts as is gone.
    far = ~binary_dilation(mask, iterations=2)
    assert np.square(image - truth)[far].mean() < 0.5 * np.square(fog - truth)[far].mean()
    rows = [json.loads(line) for line in (run.path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [50, 100, 150, 200, 250, 300] and rows[-1]["psnr"] > rows[0]["psnr"]
    # Of all of the box's pixels most are background, which is learnt first.
    assert rows[-1]["box_psnr"] > rows[-1]["psnr"]
    assert run.config["trained"]["steps"] == 300 and run.config["trained"]["done"]
    assert list(run.path.glob("events*"))


def test_resumed_training_ends_at_the_weights_of_an_uninterrupted_one(capture, tmp_path):
    """To the last bit but for the order in which threads add up gradients of the hash table."""
    whole = taken(start(tmp_path / "whole", capture, TINY, OPTIONS), 30)
    whole.publish()
    half = taken(start(tmp_path / "half", capture, TINY, OPTIONS), 15)
    half.save()
    taken(half, 4)  # steps that are lost, as when the process is killed
    again = taken(resume(tmp_path / "half", capture), 15)
    again.publish()
    assert again.progress.step == 30
    for key, value in whole.run.field_tensors().items():
        np.testing.assert_allclose(again.run.field_tensors()[key], value, rtol=0, atol=2e-4 * np.abs(value).max())
    fresh = start(tmp_path / "other", capture, TINY, dataclasses.replace(OPTIONS, seed=5)).run.field_tensors()
    assert np.abs(fresh["weights"] - whole.run.field_tensors()["weights"]).max() > 0.01


def test_nothing_is_compiled_once_warm(capture, tmp_path):
    trainer = taken(start(tmp_path / "run", capture, TINY, OPTIONS), 12)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        taken(trainer, 25)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert len(history) > 100
    assert [kernel["size"] for kernel in history if not kernel["cache_hit"]] == []


def from_the_ball(capture, batch):
    """How far each ray passes from the ball's centre, and the ball's radius."""
    vertices = capture.poses.vertices[capture.poses.index(batch.frame)]
    centre, radius = vertices.mean(0), np.linalg.norm(vertices - vertices.mean(0), axis=1).max()
    away = batch.origin - centre[:, None]
    return np.linalg.norm(away - (away * batch.direction).sum(0) * batch.direction, axis=0), radius


def test_rays_hit_what_they_should(capture):
    sampler = RaySampler(capture, capture.splits["train"], dataclasses.replace(OPTIONS, rays=1000))
    batch = sampler(np.random.default_rng(0))
    assert batch.origin.shape == batch.direction.shape == batch.target.shape == (3, 1000)
    np.testing.assert_allclose(np.linalg.norm(batch.direction, axis=0), 1, atol=1e-6)
    distance, radius = from_the_ball(capture, batch)
    # On the mask is where the ray meets the ball, up to a pixel.
    pixel = 2.5 / 72
    assert (distance[batch.mask > 0] < radius + pixel).all() and (distance[batch.mask == 0] > radius - 2 * pixel).all()
    assert 0.5 < batch.mask.mean() < 0.95
    background = np.round(capture.background * 255) / 255
    np.testing.assert_allclose(batch.target[:, distance > radius + pixel], background[:, None].repeat((distance > radius + pixel).sum(), 1),
                               atol=1e-6)


def test_edge_pixels_are_left_out(capture):
    sampler = RaySampler(capture, capture.splits["train"], dataclasses.replace(OPTIONS, edge_kernel=3, rays=4000))
    batch = sampler(np.random.default_rng(0))
    target = batch.target[:, batch.mask == 0]
    np.testing.assert_allclose(target, np.broadcast_to(capture.background[:, None], target.shape), atol=3e-3)


def test_the_mask_is_sure_off_its_edge_alone(capture):
    """Where pixels are covered in part, which the mask does not say, its term in the loss is silent."""
    sampler = RaySampler(capture, capture.splits["train"], dataclasses.replace(OPTIONS, opacity_edge=3, rays=4000))
    batch = sampler(np.random.default_rng(0))
    distance, radius = from_the_ball(capture, batch)
    off, pixel = np.abs(distance - radius), 2.5 / 72
    assert (batch.sure[off < 0.3 * pixel] == 0).all() and (off < 0.3 * pixel).sum() > 10
    assert (batch.sure[off > 3 * pixel] == 1).all()
    whole = RaySampler(capture, capture.splits["train"], dataclasses.replace(OPTIONS, opacity_edge=0))(np.random.default_rng(0))
    assert (whole.sure == 1).all()

    loss = ImageLoss(dataclasses.replace(OPTIONS, opacity_weight=1.0, edge_weight=0.0), mi.Color3f(0.0), 0.08, 1.0)
    seen = Radiance(dr.zeros(mi.Color3f, 2), mi.Float(0.5, 0.5), *[None] * 5, 0)
    total = [loss(seen, mi.Color3f(0.0), mi.Float(1, 1), mi.Float(*sure)).total[0] for sure in ((1, 1), (1, 0), (0, 0))]
    np.testing.assert_allclose(total, [0.25, 0.125, 0])


def test_the_error_of_the_boxs_rays_is_told_apart(capture):
    """Of rays drawn from the mask half miss by 0.5, of those from the box a quarter: counted by what they were drawn from."""
    sampler = RaySampler(capture, capture.splits["train"], dataclasses.replace(OPTIONS, rays=2000, mask_share=0.25))
    batch = sampler(np.random.default_rng(0))
    assert batch.in_box.mean() == pytest.approx(0.75, abs=0.01) and (batch.mask[batch.in_box == 0] == 1).all()
    # The box's rays see the performer as often as its pixels show it: less often than not.
    assert batch.mask[batch.in_box == 1].mean() < 0.9
    off = np.where(batch.in_box == 1, np.arange(2000) % 4 == 0, np.arange(2000) % 2 == 0)
    loss = ImageLoss(dataclasses.replace(OPTIONS, opacity_weight=0.0, edge_weight=0.0), mi.Color3f(0.0), 0.08, 1.0)
    seen = Radiance(dr.zeros(mi.Color3f, 2000), dr.ones(mi.Float, 2000), *[None] * 5, 0)
    found = loss(seen, mi.Color3f(mi.Float(0.5 * off)), mi.Float(0), mi.Float(0), mi.Float(batch.in_box))
    of_box, of_mask = (0.25 * off[batch.in_box == kind].mean() for kind in (1, 0))
    assert float(found.box[0]) == pytest.approx(of_box, rel=1e-5)
    assert float(found.image[0]) == pytest.approx(0.25 * off.mean(), rel=1e-5) and of_mask > 1.5 * of_box
    assert loss(seen, mi.Color3f(0.0), mi.Float(0), mi.Float(0)).box is None


def test_a_run_is_not_overwritten_and_belongs_to_its_capture(capture, write_capture, tmp_path):
    from ndf_mi.capture.capture import Capture

    start(tmp_path / "run", capture, TINY, OPTIONS)
    with pytest.raises(InputError, match="--resume"):
        start(tmp_path / "run", capture, TINY, OPTIONS)
    with pytest.raises(InputError, match="other"):
        resume(tmp_path / "run", Capture.read(write_capture("other")))
    with pytest.raises(InputError, match="config.json"):
        resume(tmp_path / "nothing", capture)


@pytest.mark.parametrize("damage", ["truncate", "state", "newer", "options"])
def test_damaged_runs_are_refused_by_name(capture, tmp_path, damage):
    trainer = taken(start(tmp_path / "run", capture, TINY, OPTIONS), 1)
    trainer.save()
    config = tmp_path / "run" / "config.json"
    values = json.loads(config.read_text())
    if damage == "truncate":
        file = tmp_path / "run" / "field.safetensors"
        file.write_bytes(file.read_bytes()[:1000])
        match = "field.safetensors"
    elif damage == "state":
        (tmp_path / "run" / "state.safetensors").write_bytes(b"nonsense")
        match = "state.safetensors"
    elif damage == "newer":
        config.write_text(json.dumps(values | {"version": 2}))
        match = "newer ndf-mi"
    else:
        config.write_text(json.dumps(values | {"preset": values["preset"] | {"colour_of_sky": 1}}))
        match = "colour_of_sky"
    with pytest.raises(InputError, match=match):
        resume(tmp_path / "run", capture)


@pytest.mark.parametrize(("change", "word"), [({"rays": 0}, "rays"), ({"mask_share": 2.0}, "mask-share"), ({"seed": -1}, "seed")])
def test_wrong_options_are_named(change, word):
    with pytest.raises(InputError, match=word):
        dataclasses.replace(OPTIONS, **change)


def test_an_interrupt_finishes_the_step_and_keeps_the_state(capture, tmp_path, monkeypatch):
    whole = taken(start(tmp_path / "whole", capture, TINY, dataclasses.replace(OPTIONS, steps=12)), 12)
    whole.publish()
    trainer = start(tmp_path / "run", capture, TINY, dataclasses.replace(OPTIONS, steps=12))
    step = trainer.step

    def interrupted_step():
        if trainer.progress.step == 5:
            signal.raise_signal(signal.SIGINT)
        step()

    monkeypatch.setattr(trainer, "step", interrupted_step)
    with pytest.raises(KeyboardInterrupt):
        train(trainer, quiet=True)
    assert trainer.progress.step == 6 and not json.loads((tmp_path / "run" / "config.json").read_text())["trained"]["done"]
    again = resume(tmp_path / "run", capture)
    assert again.progress.step == 6
    train(again, quiet=True)
    assert again.progress.step == 12
    for key, value in whole.run.field_tensors().items():
        np.testing.assert_allclose(again.run.field_tensors()[key], value, rtol=0, atol=2e-4 * np.abs(value).max())


def test_a_training_that_diverges_stops_with_a_message_and_keeps_the_last_good_state(capture, tmp_path, monkeypatch):
    """Here the first: states to go back to are far between, and what came after it may be what led astray."""
    trainer = start(tmp_path / "run", capture, TINY, OPTIONS)
    first = (tmp_path / "run" / "field.safetensors").read_bytes()
    taken(trainer, 2).save()
    assert (tmp_path / "run" / "field.safetensors").read_bytes() != first
    bad = lambda self, seen, *truth: Loss(dr.sum(seen.opacity) * mi.Float(dr.nan), mi.Float(0.1))  # noqa: E731
    monkeypatch.setattr(ImageLoss, "__call__", bad)
    with pytest.raises(InputError, match="learning rate"):
        train(trainer, quiet=True)
    assert (tmp_path / "run" / "field.safetensors").read_bytes() == first
    assert resume(tmp_path / "run", capture).progress.step == 2


def test_a_lost_state_is_told(capture, tmp_path):
    trainer = start(tmp_path / "run", capture, TINY, dataclasses.replace(OPTIONS, steps=2))
    train(trainer, quiet=True)
    (tmp_path / "run" / "state.safetensors").unlink()
    with pytest.raises(InputError, match="state.safetensors"):
        resume(tmp_path / "run", capture)
