"""The method on a limb: it learns views and poses, resumes in either stage, compiles nothing once warm."""

from __future__ import annotations

import dataclasses
import json
import os
import signal

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.methods.animatable_nerf.architecture import FAST
from ndf_mi.methods.animatable_nerf.method import AnimatableNerf
from ndf_mi.methods.base import Budget, Method, Resumable
from ndf_mi.methods.registry import entry
from ndf_mi.methods.volume.method import STATE, VolumePreset
from ndf_mi.methods.volume.optimisation import Schedule
from ndf_mi.methods.volume.rays import RaySettings

SMALL = dataclasses.replace(
    FAST, blend_layers=(16,), novel=Schedule(20, 4e-3), novel_points=2048,
    canonical=dataclasses.replace(FAST.canonical, grid_levels=4, grid_entries=2**12, grid_finest=64))


class Small(AnimatableNerf):
    presets = {"fast": VolumePreset(SMALL, Schedule(60, 1e-2),
                                    RaySettings(rays=256, samples=32, opacity_weight=0.05))}


@pytest.fixture(scope="module")
def trained(limb_capture: Capture) -> Small:
    method = Small(samples=32)
    method.fit(limb_capture, Budget(seed=1))
    return method


def error(capture: Capture, method: Method, frame: int) -> float:
    image = method.render(capture.cameras["n0"], frame)
    assert image.dtype == np.float32 and image.min() >= 0 and image.max() <= 1
    return float(np.square(image - capture.image("n0", frame)).mean())


@pytest.mark.parametrize(("frame", "share"), [(1, 0.3), (6, 0.5)])
def test_it_learns_views_and_poses_that_it_has_not_seen(limb_capture, trained, frame, share) -> None:
    blank = np.square(limb_capture.image("n0", frame) - limb_capture.background).mean()
    assert error(limb_capture, trained, frame) < share * blank


def test_metadata(limb_capture, trained) -> None:
    known = trained.metadata()
    json.dumps(known, allow_nan=False)
    assert known["steps"] == 60 and known["final_steps"] == 20
    assert known["history"][-1][0] == 60 and known["seconds"] > known["history"][-1][1]
    assert "2 frames without images" in known["note"]


def test_saved_and_loaded_it_renders_the_same(limb_capture, trained, tmp_path) -> None:
    trained.save(tmp_path)
    loaded = Small(samples=32)
    loaded.load(tmp_path, limb_capture)
    camera = limb_capture.cameras["n0"]
    np.testing.assert_array_equal(loaded.render(camera, 5), trained.render(camera, 5))
    assert loaded.metadata() == trained.metadata() and loaded.cache_key() == trained.cache_key()


@pytest.mark.parametrize("integrator", ["ndf_quadrature", "ndf_path"])
def test_in_a_scene_it_looks_as_in_the_method_s_images(limb_capture, trained, integrator) -> None:
    camera = limb_capture.cameras["n0"]
    behind = srgb_to_linear(limb_capture.background.astype(np.float64)).tolist()
    scene = mi.load_dict({
        "type": "scene", "performer": trained.shape(6), "sensor": camera.sensor(spp=1, sampler="independent"),
        "integrator": {"type": integrator, "samples": 32},
        "light": {"type": "constant", "radiance": {"type": "rgb", "value": behind}}})
    image = linear_to_srgb(mi.render(scene, spp=16).numpy()[..., :3])
    expected = trained.render(camera, 6)
    # Rays pass through pixels at random instead of through their centres.
    assert np.abs(expected - limb_capture.background).max() > 0.2
    assert np.sqrt(np.square(image - expected).mean()) < 0.02


def test_it_is_not_scattered(limb_capture, trained) -> None:
    scene = mi.load_dict({
        "type": "scene", "performer": trained.shape(6), "light": {"type": "constant"},
        "sensor": limb_capture.cameras["n0"].sensor(spp=1, sampler="independent"),
        "integrator": {"type": "volpath"}})
    with pytest.raises(InputError, match="ndf_path"):
        scene.integrator().render(scene, sensor=scene.sensors()[0], spp=1)


@pytest.mark.parametrize("stop", [41, 71])
def test_a_stopped_training_ends_where_an_uninterrupted_one_does(limb_capture, trained, tmp_path, monkeypatch,
                                                                 stop) -> None:
    from ndf_mi.methods.volume.optimisation import Optimisation

    taken, step = [], Optimisation.step

    def counted(self: Optimisation) -> None:
        step(self)
        taken.append(self.steps)
        if len(taken) == stop:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(Optimisation, "step", counted)
    stopped, budget = Small(samples=32), Budget(seed=1)
    assert isinstance(stopped, Resumable)
    with pytest.raises(KeyboardInterrupt):
        stopped.fit_in(tmp_path, limb_capture, budget)
    assert (tmp_path / STATE).exists()
    again = Small(samples=32)
    again.fit_in(tmp_path, limb_capture, budget)
    assert len(taken) == 80 and not (tmp_path / STATE).exists()
    for key in ("steps", "final_steps"):
        assert again.metadata()[key] == trained.metadata()[key]
    assert [row[0] for row in again.metadata()["history"]] == [25, 50, 60]
    for name, value in trained.parameters.items():
        difference = np.abs(again.parameters[name].numpy() - value.numpy())
        # Sums of gradients are not added in the same order twice.
        assert np.median(difference) < 1e-4, name


def test_nothing_is_compiled_once_warm(limb_capture, monkeypatch) -> None:
    from ndf_mi.methods.volume.optimisation import Optimisation

    compiled, counts, step = [], [], Optimisation.step

    def counted(self: Optimisation) -> None:
        dr.kernel_history_clear()
        step(self)
        history = dr.kernel_history([dr.KernelType.JIT])
        counts.append(len(history))
        if self.steps > self.schedule.steps // 2:
            compiled.extend(kernel["size"] for kernel in history if not kernel["cache_hit"])

    monkeypatch.setattr(Optimisation, "step", counted)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        Small().fit(limb_capture, Budget(seed=1))
    assert len(counts) == 80 and min(counts) > 20 and compiled == []


@pytest.mark.long
def test_the_published_sizes_train_and_render(limb_capture) -> None:
    of = AnimatableNerf.presets["paper"]
    shape = dataclasses.replace(of.architecture, novel_points=2048,
                                novel=dataclasses.replace(of.architecture.novel, steps=2))

    class Paper(AnimatableNerf):
        presets = {"paper": dataclasses.replace(
            of, architecture=shape, schedule=dataclasses.replace(of.schedule, steps=2),
            rays=dataclasses.replace(of.rays, rays=64, samples=16))}

    method = Paper("paper", samples=4)
    method.fit(limb_capture, Budget(seed=1))
    known = method.metadata()
    assert known["steps"] == known["final_steps"] == 2 and np.isfinite(known["final_loss"])
    # Two networks of blend weights for two joints, the canonical one, and codes of three and two frames.
    blend = 564_760 - 257 * 22
    assert known["parameters"] == 2 * blend + 694_404 + 128 * (4 + 3 + 2)
    assert np.isfinite(method.render(limb_capture.cameras["n0"], 6)).all()


def test_seconds_are_shared_by_both_stages(limb_capture) -> None:
    method = Small()
    method.fit(limb_capture, Budget(seconds=3.0))
    known = method.metadata()
    on_rays = known["history"][-1][1]
    assert 2.7 <= on_rays < known["seconds"] and known["seconds"] >= 3.0 and known["final_steps"] > 0


def test_it_is_registered_and_refuses_a_body_without_joints(capture) -> None:
    method = entry("animatable-nerf").create({"preset": "paper"})
    assert method.label == "Animatable NeRF"
    with pytest.raises(InputError, match="body.npz.*skinning model"):
        method.fit(capture, Budget(seconds=1.0))
