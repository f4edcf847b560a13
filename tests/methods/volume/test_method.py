"""A method on the smallest volume: it learns a ball, resumes exactly, compiles nothing once warm."""

import json
import os
import signal

import drjit as dr
import numpy as np
import pytest
from tiny_volume import BallMethod

from ndf_mi.errors import InputError
from ndf_mi.methods.base import Budget, Method, Resumable
from ndf_mi.methods.volume.method import STATE
from ndf_mi.methods.volume.record import FILE_NAME, TENSORS


def fitted(capture, **keys) -> BallMethod:
    method = BallMethod(**{"samples": 32, **keys})
    method.fit(capture, Budget(seed=1))
    return method


@pytest.fixture(scope="module")
def trained(capture) -> BallMethod:
    return fitted(capture)


def error(capture, method, camera="n0", frame=7) -> float:
    image = method.render(capture.cameras[camera], frame)
    assert image.dtype == np.float32 and image.min() >= 0 and image.max() <= 1
    return float(np.square(image - capture.image(camera, frame)).mean())


def test_it_learns_views_and_poses_that_it_has_not_seen(capture, trained):
    method: Method = trained
    blank = np.square(capture.image("n0", 7) - capture.background).mean()
    assert error(capture, method) < 0.25 * blank


def test_metadata(capture, trained):
    known = trained.metadata()
    json.dumps(known, allow_nan=False)
    assert known["steps"] == 40 and known["capture"] == capture.digest and known["parameters"] == 13
    assert known["preset"] == "fast" and known["options"] == {"preset": "fast", "samples": 32}
    steps, seconds, errors = zip(*known["history"], strict=True)
    assert steps == (25, 40) and seconds[1] > seconds[0] and errors[1] < errors[0]


def test_saved_and_loaded_it_renders_the_same(capture, trained, tmp_path):
    trained.save(tmp_path)
    loaded = BallMethod(samples=32)
    loaded.load(tmp_path, capture)
    camera = capture.cameras["n1"]
    np.testing.assert_array_equal(loaded.render(camera, 5), trained.render(camera, 5))
    assert loaded.metadata() == trained.metadata() and loaded.cache_key() == trained.cache_key()
    assert BallMethod(samples=16)._renderer.samples == 16
    other = BallMethod(samples=16)
    other.load(tmp_path, capture)
    assert other.cache_key() != loaded.cache_key()


def test_a_stopped_training_ends_where_an_uninterrupted_one_does(capture, trained, tmp_path):
    budget, stopped = Budget(seed=1), BallMethod(samples=32)

    def stop(seconds, step, loss):
        if step == 17:
            os.kill(os.getpid(), signal.SIGTERM)

    assert isinstance(stopped, Resumable)
    with pytest.raises(KeyboardInterrupt):
        stopped.fit_in(tmp_path, capture, budget, stop)
    assert (tmp_path / STATE).exists() and not (tmp_path / FILE_NAME).exists()
    taken = []
    again = BallMethod(samples=32)
    again.fit_in(tmp_path, capture, budget, lambda seconds, step, loss: taken.append(step))
    assert taken == list(range(18, 41)) and not (tmp_path / STATE).exists()
    for name, value in trained.parameters.items():
        np.testing.assert_allclose(again.parameters[name], value, rtol=1e-4, atol=1e-5)
    # Once finished it is loaded, and another budget replaces it.
    BallMethod(samples=32).fit_in(tmp_path, capture, budget, lambda *_: pytest.fail("trained again"))
    other = BallMethod(samples=32)
    other.fit_in(tmp_path, capture, Budget(seed=2))
    assert other.metadata()["seed"] == 2


def test_seconds_end_a_training(capture):
    method = BallMethod()
    method.fit(capture, Budget(seconds=1e-3))
    assert method.metadata()["steps"] == 1 and method.metadata()["budget"] == 1e-3


def test_nothing_is_compiled_once_warm(capture):
    histories, method = [], BallMethod()

    def watch(seconds, step, loss):
        if step == 20:
            dr.kernel_history_clear()
        elif step == 40:
            histories.extend(dr.kernel_history([dr.KernelType.JIT]))

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        method.fit(capture, Budget(), watch)
    assert len(histories) > 20 and [kernel["size"] for kernel in histories if not kernel["cache_hit"]] == []


def test_offsets_of_the_surface_are_kept(shrunk_capture, tmp_path):
    method = fitted(shrunk_capture, preset="offset")
    offsets = method._tensors["offsets"]
    assert np.median(np.linalg.norm(offsets, axis=1)) > 0.01
    assert method.metadata()["surface_seconds"] > 0 and method.size == 13
    method.save(tmp_path)
    loaded = BallMethod(preset="offset", samples=32)
    loaded.load(tmp_path, shrunk_capture)
    camera = shrunk_capture.cameras["n1"]
    np.testing.assert_array_equal(loaded.render(camera, 5), method.render(camera, 5))


def test_wrong_input_is_refused(capture, write_capture, trained, tmp_path):
    with pytest.raises(InputError, match="preset.*'slow'.*fast, offset"):
        BallMethod(preset="slow")
    with pytest.raises(InputError, match="samples"):
        BallMethod(samples=0)
    with pytest.raises(InputError, match=FILE_NAME):
        BallMethod().load(tmp_path, capture)
    trained.save(tmp_path)
    known = json.loads((tmp_path / FILE_NAME).read_text())
    for change, words in (({"version": 9}, "version"), ({"method": "box"}, "method"), ({"seed": "x"}, "seed"),
                          ({"capture": "0"}, "capture"), ({"preset": {}}, "preset"), ({"x": 1}, "x")):
        (tmp_path / FILE_NAME).write_text(json.dumps({**known, **change}))
        with pytest.raises(InputError, match=f"{FILE_NAME}.*{words}"):
            BallMethod().load(tmp_path, capture)
    (tmp_path / FILE_NAME).write_text(json.dumps(known))
    (tmp_path / TENSORS).write_bytes(b"truncated")
    with pytest.raises(InputError, match=TENSORS):
        BallMethod().load(tmp_path, capture)
