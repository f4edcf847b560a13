"""Training through scattering recovers density and albedo, resumes, and refuses bad input before writing
anything."""

import dataclasses
import json

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi import commands, files
from ndf_mi.colour import linear_to_srgb
from ndf_mi.commands.training_options import configured
from ndf_mi.field import preset
from ndf_mi.learn.loop import resume, start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import relightable
from ndf_mi.render.majorant import densities
from ndf_mi.run import Run

TINY, _ = relightable(dataclasses.replace(preset("tiny"), band_inside=0.08, pose_layers=(),
                                          density_limit=60.0))
OPTIONS = TrainingOptions(surface="body", steps=120, warm_up=60, rays=256, samples=24, paths=8, max_depth=6,
                          cell=0.02, seed=4, integrator="prbvolpath", learning_rate=1e-2, grid_rate=3e-2,
                          pose_noise=0.0)
ALBEDO = (0.9, 0.6, 0.3)


@pytest.fixture
def truth(make_constant_run):
    """An opaque ball of one albedo."""
    srgb = tuple(float(linear_to_srgb(np.array(a))) for a in ALBEDO)
    return make_constant_run(25.0, srgb=srgb, name="truth", direction_octaves=-1, normal_octaves=-1)


def in_band(run, count=4000):
    """Random points just below the ball's surface, which light and cameras reach, at frame 1."""
    rng = np.random.default_rng(0)
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return d * (0.3 + rng.uniform(0.0, 0.06, (count, 1))) + run.poses.translation[run.poses.index(1)]


def albedo_of(run, points):
    posed = run.posed(1)
    posed.bound.pack()
    sample = posed.fused(mi.Point3f(points.T.astype(np.float32)), mi.Vector3f(0, 0, 1))
    weight = sample.sigma.numpy()
    return (sample.colour.numpy() * weight).sum(1) / weight.sum()


@pytest.mark.long
def test_density_and_albedo_are_recovered(truth, lit_capture, tmp_path):
    capture = lit_capture(truth, "day", spp=256)
    trainer = start(tmp_path / "run", capture, TINY,
                    dataclasses.replace(OPTIONS, steps=600, warm_up=100, decay=0.3))
    while not trainer.scattering:
        trainer.step()
    trainer.publish()
    points = in_band(trainer.run)
    before = albedo_of(trainer.run, points)
    train(trainer, quiet=True)
    run = Run.load(tmp_path / "run")
    after = albedo_of(run, points)
    assert np.abs(after - ALBEDO).max() < 0.08
    assert np.abs(after - ALBEDO).max() < 0.5 * np.abs(before - ALBEDO).max()
    # Opaque where the truth is: 1/e of the light passes through 4 cm of it.
    assert 12 < np.median(densities(run.posed(1), points)) < 60
    assert run.config["training"]["integrator"] == "prbvolpath" and run.config["trained"]["done"]
    rows = [json.loads(line) for line in (run.path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(150, 601, 50))


@pytest.mark.long
def test_no_kernel_is_compiled_from_frame_to_frame(truth, lit_capture, tmp_path):
    trainer = start(tmp_path / "run", lit_capture(truth, "day"), TINY,
                    dataclasses.replace(OPTIONS, warm_up=0))
    for _ in range(6):
        trainer.step()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for _ in range(6):
            trainer.step()
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history and sum(not kernel["cache_hit"] for kernel in history) == 0


def test_a_resumed_training_continues_where_it_stopped(truth, lit_capture, tmp_path):
    capture = lit_capture(truth, "day")
    options = dataclasses.replace(OPTIONS, steps=7, warm_up=3, rays=128)
    whole = start(tmp_path / "whole", capture, TINY, options)
    half = start(tmp_path / "half", capture, TINY, options)
    for _ in range(7):
        whole.step()
    for _ in range(5):
        half.step()
    half.save()
    again = resume(tmp_path / "half", capture)
    assert again.scattering
    while again.done < 1:
        again.step()
    for key, value in whole.parameters.arrays().items():
        np.testing.assert_allclose(again.parameters.arrays()[key], value, rtol=0,
                                   atol=1e-2 * np.abs(value).max())


@pytest.mark.long
def test_refused_steps_are_counted_and_reported_where_scattering_begins(truth, lit_capture, tmp_path, poison,
                                                                        capsys):
    options = dataclasses.replace(OPTIONS, steps=4, warm_up=2, rays=64)
    trainer = start(tmp_path / "run", lit_capture(truth, "day"), TINY, options)
    # The second step by quadrature, and the first through scattering.
    drawn = poison(trainer, {2, 4})
    train(trainer, quiet=True)
    assert drawn == [False, False, False, True, True, True]
    printed = capsys.readouterr().out
    assert "step 2" in printed and "step 3" in printed
    progress = trainer.progress
    assert (progress.step, progress.steps_refused, progress.rate_factor) == (4, 2, 0.25)


def test_the_paper_preset_gets_a_density_above_0(truth, lit_capture, tmp_path, capsys):
    changed, changes = relightable(preset("paper"))
    assert changed.density_activation == "softplus"
    # As `--option` takes them.
    assert {"density_activation=softplus", "density_limit=150"} <= set(changes)
    assert configured("paper", integrator="prbvolpath")[0].density_activation == "softplus"
    changed, changes = relightable(preset("fast"))
    assert not changed.pose_products and "pose_products=false" in changes
    capture = lit_capture(truth, "day")
    without_light(capture.path)
    arguments = ["optimise", str(capture.path), "-o", str(tmp_path / "out"), "--preset", "paper",
                 "--integrator", "prbvolpath"]
    assert commands.main(arguments) == 2
    assert "lighting" in capsys.readouterr().err


def test_a_training_that_ends_before_scattering_begins_warns(truth, lit_capture, tmp_path, capsys):
    capture = lit_capture(truth, "day")
    arguments = ["optimise", str(capture.path), "-o", str(tmp_path / "run"), "--preset", "tiny",
                 "--integrator", "prbvolpath",
                 "--seconds", "0.001", "--option", "rays=64", "--option", "samples=8"]
    assert commands.main(arguments) == 0
    printed = capsys.readouterr().out
    assert "prbvolpath" in printed and "1500" in printed and "warm_up" in printed
    assert "density_limit=150" in printed
    assert not Run.load(tmp_path / "run").scattered


@pytest.fixture
def refused(truth, lit_capture, tmp_path, capsys):
    """Calls `ndf-mi optimise`, which must exit with code 2 and write nothing; returns its error message."""
    capture = lit_capture(truth, "day")

    def call(integrator="prbvolpath", change=None, *more):
        if change is not None:
            change(capture.path)
        out = tmp_path / "out"
        assert commands.main(["optimise", str(capture.path), "-o", str(out), "--preset", "tiny",
                              "--integrator", integrator, "--option", "surface=body", *more]) == 2
        assert not out.exists()
        return capsys.readouterr().err

    return call


def without_light(folder):
    document = json.loads((folder / "capture.json").read_text())
    del document["lighting"]
    files.write_json(folder / "capture.json", document)


def dark(folder):
    (folder / "lighting.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')


def close(folder):
    """Moves a camera to 5 cm from the ball's surface at frame 0."""
    document = json.loads((folder / "capture.json").read_text())
    (camera,) = (camera for camera in document["cameras"] if camera["name"] == "c1")
    for row, value in zip(camera["transform_matrix"], (0.0, 0.0, 0.35), strict=False):
        row[3] = value
    files.write_json(folder / "capture.json", document)


@pytest.mark.parametrize(("arguments", "words"), [
    (("moonbeam",), ["moonbeam", "prbvolpath"]),
    (("volpath",), ["volpath", "prbvolpath"]),
    (("prb",), ["prb", "prbvolpath"]),
    (("prbvolpath", without_light), ["capture.json: lighting"]),
    (("prbvolpath", dark), ["lighting.xml", "emitter"]),
    (("prbvolpath", lambda folder: (folder / "lighting.xml").unlink()), ["lighting.scene"]),
    (("prbvolpath", None, "--option", "normal_octaves=1"), ["normal_octaves", "-1"]),
    (("prbvolpath", None, "--option", "density_activation=relu"), ["density_activation", "relu", "softplus"]),
    (("prbvolpath", close), ["c1", "frame 0", "5.0 cm"]),
    (("prbvolpath", None, "--option", "paths=1"), ["paths", "1", "2"]),
    (("prbvolpath", None, "--steps", "100"), ["warm-up", "1500", "100"]),
])
def test_what_cannot_be_trained_on_is_refused_and_nothing_written(refused, arguments, words):
    message = refused(*arguments)
    for word in words:
        assert word in message
