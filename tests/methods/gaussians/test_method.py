"""Gaussians on the capture of a sphere: they learn it, resume exactly, and compile nothing once warm."""

from __future__ import annotations

import dataclasses
import json
import os
import signal

import drjit as dr
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from ndf_mi.errors import InputError
from ndf_mi.methods.base import Budget, Method, Resumable
from ndf_mi.methods.gaussians.method import Gaussians
from ndf_mi.methods.gaussians.training import Settings
from ndf_mi.methods.volume.method import STATE
from ndf_mi.methods.volume.optimisation import Schedule
from ndf_mi.methods.volume.record import FILE_NAME, TENSORS

SETTINGS = Settings(spacing=3.0, surface="body", rounds=2, schedule=Schedule(60, 1e-2, 0.1))


def small(**changes) -> Gaussians:
    return Gaussians(dataclasses.replace(SETTINGS, **changes))


@pytest.fixture(scope="module")
def trained(capture) -> Gaussians:
    method = small()
    method.fit(capture, Budget(seed=1))
    return method


def test_it_learns_views_and_poses_that_it_has_not_seen(capture, trained):
    method: Method = trained
    for frame in (5, 7):
        image, truth = method.render(capture.cameras["n0"], frame), capture.image("n0", frame)
        assert image.dtype == np.float32 and image.min() >= 0 and image.max() <= 1
        assert np.square(image - truth).mean() < 0.2 * np.square(truth - capture.background).mean()


def test_metadata(capture, trained):
    known = trained.metadata()
    json.dumps(known, allow_nan=False)
    assert known["steps"] == 60 and known["capture"] == capture.digest and known["seed"] == 1
    assert known["primitives"] == len(trained.posed(2).opacity) > 300
    steps, _, errors = zip(*known["history"], strict=True)
    assert steps == (25, 50, 60) and errors[2] < errors[0]


def test_saved_and_loaded_it_renders_the_same(capture, trained, tmp_path):
    trained.save(tmp_path)
    loaded = Gaussians()
    loaded.load(tmp_path, capture)
    camera = capture.cameras["n1"]
    np.testing.assert_array_equal(loaded.render(camera, 5), trained.render(camera, 5))
    assert loaded.metadata() == trained.metadata() and loaded.cache_key() == trained.cache_key()
    with pytest.raises(InputError, match="no such file"):
        Gaussians().load(tmp_path / "nowhere", capture)
    tensors = load_file(tmp_path / TENSORS)
    save_file({**tensors, "triangle": tensors["triangle"] + 10**6}, tmp_path / TENSORS)
    with pytest.raises(InputError, match="triangle.*indices"):
        small().load(tmp_path, capture)
    save_file({**tensors, "offset": tensors["offset"][:, 1:].copy()}, tmp_path / TENSORS)
    with pytest.raises(InputError, match="offset.*shape"):
        small().load(tmp_path, capture)


def test_a_stopped_training_ends_where_an_uninterrupted_one_does(capture, trained, tmp_path):
    def stop(seconds, step, loss):
        if step == 33:
            os.kill(os.getpid(), signal.SIGTERM)

    assert isinstance(small(), Resumable)
    with pytest.raises(KeyboardInterrupt):
        small().fit_in(tmp_path, capture, Budget(seed=1), stop)
    assert (tmp_path / STATE).exists() and not (tmp_path / FILE_NAME).exists()
    taken = []
    again = small()
    again.fit_in(tmp_path, capture, Budget(seed=1), lambda seconds, step, loss: taken.append(step))
    assert taken == list(range(34, 61)) and not (tmp_path / STATE).exists()
    camera = capture.cameras["n1"]
    # Gradients are added up in varying order.
    assert np.abs(again.render(camera, 5) - trained.render(camera, 5)).mean() < 2e-3
    small().fit_in(tmp_path, capture, Budget(seed=1), lambda *_: pytest.fail("trained again"))
    other = small(schedule=Schedule(2, 1e-2))
    other.fit_in(tmp_path, capture, Budget(seed=1))
    assert other.metadata()["steps"] == 2


def test_steps_compile_nothing_between_rounds_of_splitting(capture):
    compiled: list[int] = []

    def count(seconds, step, loss):
        compiled.append(sum(not kernel["cache_hit"] for kernel in dr.kernel_history()
                            if kernel["type"] == dr.KernelType.JIT))

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        small(rounds=1, densified=0.25, schedule=Schedule(40, 1e-2)).fit(capture, Budget(seed=3), count)
    # Lists of hits are padded to one of a few lengths, of which some may not have come up before.
    assert sum(number > 0 for number in compiled[-20:]) <= 3
