"""The mesh baseline on a sphere whose texture is known."""

from __future__ import annotations

import json
import time

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.methods.mesh import TexturedMesh
from ndf_mi.surface import texture_fit as mesh_fit
from ndf_mi.surface.offset_fit import OffsetFit
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.texture_fit import RATES, TextureFit
from ndf_mi.surface.textured import TexturedSurface
from ndf_mi.surface.training_views import TrainingViews


def box_psnr(capture, method, camera: str, frame: int) -> float:
    image = method.render(capture.cameras[camera], frame)
    assert image.dtype == np.float32 and image.min() >= 0 and image.max() <= 1
    mask = metrics.box_mask(capture.cameras[camera], capture.poses.vertices[capture.poses.index(frame)])
    return metrics.psnr(capture.image(camera, frame), image, mask)


@pytest.fixture(scope="module")
def trained(capture) -> TexturedMesh:
    mesh = TexturedMesh(capture, size=64)
    mesh.fit(capture, seconds=4.0, seed=1)
    return mesh


def test_recovers_the_texture(capture, trained):
    assert box_psnr(capture, trained, "c0", 2) > 35
    assert box_psnr(capture, trained, "n0", 2) > 33
    assert box_psnr(capture, trained, "n1", 7) > 33


def test_rate_is_the_best_of_the_sweep(trained):
    facts = trained.facts()
    assert set(facts["sweep"]) == {f"{rate:g}" for rate in RATES}
    assert min(facts["sweep"], key=facts["sweep"].get) == f"{facts['rate']:g}"
    assert facts["budget"] == 4.0 and facts["steps"] > 10 and 0.5 < facts["seen"] <= 1


def test_saved_and_loaded_renders_the_same(capture, trained, tmp_path):
    trained.save(tmp_path / "mesh")
    loaded = TexturedMesh.load(tmp_path / "mesh", capture)
    camera = capture.cameras["n0"]
    np.testing.assert_array_equal(loaded.render(camera, 5), trained.render(camera, 5))
    assert json.dumps(loaded.facts()) == json.dumps(trained.facts())
    (tmp_path / "mesh" / "mesh.safetensors").write_bytes(b"truncated")
    with pytest.raises(InputError, match="mesh.safetensors"):
        TexturedMesh.load(tmp_path / "mesh", capture)
    with pytest.raises(InputError, match="mesh.json"):
        TexturedMesh.load(tmp_path, capture)


def test_convergence_ends_and_lowers_the_loss(capture, monkeypatch):
    monkeypatch.setattr(mesh_fit, "WINDOW_STEPS", 16)
    mesh = TexturedMesh(capture, size=32, rate=0.1)
    mesh.fit(capture)
    facts = mesh.facts()
    assert facts["converged"] and facts["budget"] is None and not facts["sweep"]
    assert facts["history"][-1][2] < facts["history"][0][2]
    assert box_psnr(capture, mesh, "n0", 2) > 33


def test_same_seed_same_texture(capture):
    surface = TexturedSurface(capture, 32)
    results = []
    for seed in (3, 3, 4):
        fit = TextureFit(surface, capture, 32, 0.1, seed)
        fit.for_steps(3)
        results.append(fit.texture())
    np.testing.assert_allclose(results[0], results[1], atol=1e-5)
    assert np.abs(results[0] - results[2]).max() > 1e-3


@pytest.mark.parametrize("kind", ["texture", "offsets"])
def test_no_file_is_read_once_the_clock_runs(capture, monkeypatch, kind):
    """Images, and masks where they are trained on, are in memory as 8-bit values before a fit's seconds begin."""
    surface, rest = TexturedSurface(capture, 16), RestFrames(capture)
    read = capture.image

    def slow(camera, frame):
        time.sleep(0.1)
        return read(camera, frame)

    def late(camera, frame):
        pytest.fail("read while the clock runs")

    monkeypatch.setattr(capture, "image", slow)
    fit = TextureFit(surface, capture, 16, 0.1, 0) if kind == "texture" else OffsetFit(surface, rest, capture, 16, 0.1, 0.02, 0)
    assert fit.seconds < 0.5  # of eight training images, which take 0.8 s
    monkeypatch.setattr(capture, "image", late)
    monkeypatch.setattr(capture, "mask", late)
    losses = [fit.step() for _ in range(4)]
    assert np.isfinite(losses).all()


def test_training_images_are_the_captures(capture):
    views = TrainingViews(capture, 0, masks=True)
    for _ in range(2):
        frame, chosen = views.next()
        for camera, (x, y, w, h), image in chosen:
            whole, mask = capture.image(camera.name, frame), capture.mask(camera.name, frame)
            np.testing.assert_array_equal(image, whole[y : y + h, x : x + w])
            np.testing.assert_array_equal(views.coverage(camera, frame)[..., 0], mask[y : y + h, x : x + w])


def test_no_kernel_is_compiled_after_the_first_steps(capture):
    fit = TextureFit(TexturedSurface(capture, 32), capture, 32, 0.1, 0)
    fit.for_steps(4)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        fit.for_steps(6)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history and all(entry["cache_hit"] for entry in history)


def test_gradient_against_finite_differences(capture):
    surface = TexturedSurface(capture, 8)
    surface.set_frame(2)
    random = np.random.default_rng(0)
    texture, direction = random.uniform(0.2, 0.8, (2, 8, 8, 3)).astype(np.float32)

    def loss(value: mi.TensorXf) -> mi.Float:
        surface.set_texture(value)
        return dr.sum(dr.square(surface.render(capture.cameras["c1"], 4, seed=9)), axis=None)

    x = mi.TensorXf(texture)
    dr.enable_grad(x)
    dr.backward(loss(x))
    along = float((x.grad.numpy() * direction).sum())
    step = 1e-2
    ends = [float(loss(mi.TensorXf(texture + sign * step * direction)).array[0]) for sign in (1, -1)]
    assert along == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=2e-3)


def test_a_capture_without_training_images_is_refused(capture, monkeypatch):
    monkeypatch.setitem(capture.splits, "train", type(capture.splits["train"])((), ()))
    with pytest.raises(InputError, match="splits.train"):
        TexturedMesh(capture, size=32, rate=0.1).fit(capture)
