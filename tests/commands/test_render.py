"""`ndf-mi render` and `ndf-mi optimise` through the command line: what they write, and how they refuse."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from skimage.io import imread

from ndf_mi.commands import main
from ndf_mi.learn.refinement import CAMERAS, PREFIX
from ndf_mi.methods.ndf import NeuralField

SCENE = Path(__file__).parents[2] / "scenes" / "performer.xml"


def channels(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def test_a_run_to_png_and_to_exr(make_constant_run, tmp_path):
    run = make_constant_run(200.0, srgb=(0.8, 0.4, 0.2))
    view = ["--size", "40", "30", "--frame", "2", "--azimuth", "40"]
    assert main(["render", str(run.path), "-o", str(tmp_path / "a.png"), *view]) == 0
    image = imread(tmp_path / "a.png")
    assert image.shape == (30, 40, 3)
    assert np.abs(image[15, 20].astype(int) - [204, 102, 51]).max() <= 2 and (image[0, 0] == 0).all()
    assert main(["render", str(run.path), "-o", str(tmp_path / "a.exr"), "--size", "40", "30"]) == 0
    found = channels(tmp_path / "a.exr")
    geometry = {"depth.T", "uvl.U", "uvl.V", "uvl.L", "normal.X", "normal.Y", "normal.Z"}
    assert set(found) == {"R", "G", "B", "A"} | geometry
    assert found["A"][15, 20] > 0.99 and found["normal.Z"][15, 20] > 0.9
    assert found["R"][15, 20] == pytest.approx(0.604, abs=0.01)


def test_cameras_of_the_training_have_their_corrections(make_constant_run, capture, tmp_path):
    run = make_constant_run(200.0, srgb=(0.8, 0.4, 0.2))
    run.config |= {"capture": {"digest": capture.digest}, CAMERAS: ["c0"]}
    learned = {"camera_rotation": [[0, 0.1, 0]], "camera_translation": [[0.05, 0, 0]], "camera_focal": [0.2],
               "colour_matrix": [0.5 * np.eye(3)], "colour_offset": [[0.1, 0, 0]]}
    run.surface_tensors = {PREFIX + name: np.array(value, np.float32) for name, value in learned.items()}
    run.save()
    view = ["--capture", str(capture.path), "--camera"]
    for name in ("c0", "c1"):
        out = tmp_path / f"{name}.png"
        assert main(["render", str(run.path), "-o", str(out), *view, name]) == 0
        expected = NeuralField.of(run).render(capture.cameras[name], 0)
        assert expected.std() > 0.1
        np.testing.assert_allclose(imread(out) / 255, expected, atol=0.003)
    run.config["capture"]["digest"] = "another"
    run.save()
    assert main(["render", str(run.path), "-o", str(tmp_path / "plain.png"), *view, "c0"]) == 0
    assert np.abs(imread(tmp_path / "plain.png").astype(int) - imread(tmp_path / "c0.png")).max() > 50


def test_a_scene_to_exr_with_its_aovs(make_constant_run, tmp_path):
    run = make_constant_run(200.0)
    scene = tmp_path / "scene.xml"
    aovs = '<string name="aovs" value="depth,opacity"/>'
    integrator = f'<integrator type="$integrator">{aovs}</integrator>'
    scene.write_text(SCENE.read_text().replace('<integrator type="$integrator"/>', integrator))
    out = tmp_path / "b.exr"
    arguments = ["-D", f"run={run.path}", "-D", "origin=0, 0, 2", "-D", "target=0, 0, 0", "--frame", "1"]
    assert main(["render", str(scene), "-o", str(out), *arguments, "--size", "24", "20"]) == 0
    found = channels(out)
    assert found["depth.T"].shape == (20, 24) and found["opacity.A"].max() > 0.99


@pytest.mark.parametrize(("integrator", "warnings"), [("path", 1), ("volpath", 0), ("ndf_path", 0)])
def test_a_picture_without_the_performer_warns(make_constant_run, tmp_path, capsys, integrator, warnings):
    run = make_constant_run(20.0)
    out = tmp_path / "c.png"
    place = ["-D", "origin=0, 0.5, 2", "-D", "target=0, 0.2, 0", "--size", "8", "8", "--spp", "1"]
    scene = [str(SCENE.with_name("lit.xml")), "-D", f"run={run.path}", "-D", f"integrator={integrator}"]
    assert main(["render", *scene, "-o", str(out), *place]) == 0
    error = capsys.readouterr().err
    assert error.count("warning") == error.count("knows no media") == warnings
    assert imread(out).shape == (8, 8, 3)


def test_albedos_shown_as_light_warn(make_constant_run, tmp_path, capsys):
    run = make_constant_run(20.0)
    scattering = {"integrator": "prbvolpath", "warm_up": 5}
    for training, warnings in ((None, 0), ({"integrator": "ndf_quadrature"}, 0), (scattering, 1)):
        run.config["training"] = training
        run.save()
        assert main(["render", str(run.path), "-o", str(tmp_path / "d.png"), "--size", "8", "8"]) == 0
        assert capsys.readouterr().err.count("as if they were light") == warnings


@pytest.mark.parametrize(("arguments", "words"), [
    (["nowhere", "-o", "x.png"], "no such file"),
    (["RUN", "-o", "x.jpg"], ".exr or .png"),
    (["RUN", "-o", "x.png", "--frame", "9"], "9"),
    (["RUN", "-o", "x.png", "--size", "0", "4"], "--size"),
    (["RUN", "-o", "x.png", "--spp", "0"], "--spp"),
    (["RUN", "-o", "x.png", "--samples", "0"], "--samples"),
    (["RUN", "-o", "x.png", "--elevation", "90"], "--elevation"),
    ([str(SCENE), "-o", "x.png", "-D", "run=RUN", "--azimuth", "3"], "--azimuth"),
    (["RUN", "-o", "RUN/config.json/x.png"], "cannot be written"),
    (["RUN", "-o", "x.png", "--camera", "c0"], "--capture"),
    ([str(SCENE), "-o", "x.png", "-D", "run"], "NAME=VALUE"),
    ([str(SCENE), "-o", "x.png", "-D", "run=nowhere"], "nowhere"),
    ([str(SCENE), "-o", "x.png", "-D", "run=RUN", "-D", "colour=red"], "colour"),
    ([str(SCENE), "-o", "x.png", "-D", "run=RUN", "--frame", "7"], "7"),
])
def test_invalid_input_exits_with_code_2(make_run, tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    make_run("RUN")
    assert main(["render", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error and "Traceback" not in error and 'File "' not in error
    assert not list(tmp_path.glob("x.*"))


def test_optimise_and_resume(capture, tmp_path, capsys):
    out = str(tmp_path / "run")
    options = ["--preset", "tiny", "--steps", "3"]
    for option in ("rays=64", "samples=8", "density_layers=[8]"):
        options += ["--option", option]
    assert main(["optimise", str(capture.path), "-o", out, *options]) == 0
    printed = capsys.readouterr().out
    assert "3 steps" in printed and "last step's field is kept: held_back=0.05" in printed
    assert main(["optimise", str(capture.path), "-o", out, "--resume"]) == 0
    assert main(["optimise", str(capture.path), "-o", out, *options]) == 2
    assert "--resume" in capsys.readouterr().err


def test_optimise_prints_that_it_trained_on_all_views_at_last(capture, tmp_path, capsys):
    options = ["--preset", "tiny", "--steps", "51"]
    for option in ("rays=64", "samples=8", "density_layers=[8]", "held_back=0.25"):
        options += ["--option", option]
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "run"), *options]) == 0
    assert "dB at step 50 and not getting worse, and were trained on from there" in capsys.readouterr().out


def test_optimise_prints_which_step_it_keeps(capture, tmp_path, capsys):
    options = ["--preset", "tiny", "--steps", "51"]
    for option in ("rays=64", "samples=8", "density_layers=[8]", "held_back=0.25", "held_back_until=1"):
        options += ["--option", option]
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "run"), *options]) == 0
    printed = capsys.readouterr().out
    kept = json.loads((tmp_path / "run" / "config.json").read_text())["trained"]["kept"]
    assert f"{kept['held_back_psnr']:.2f} dB on held-back training views" in printed
    assert ("the best of the training" if kept["step"] == 51 else "at step 50, whose field") in printed


@pytest.mark.parametrize(("arguments", "words"), [
    (["--preset", "huge"], "fast"),
    (["--option", "colour=3"], "NAME one of"),
    (["--option", "band=wide"], "a number"),
    (["--option", "density_layers=64"], "a list of whole numbers"),
    (["--resume", "--steps", "5"], "--resume"),
    (["--resume", "--preset", "paper"], "--resume"),
    (["--steps", "0"], "steps"),
])
def test_optimises_mistakes(capture, tmp_path, capsys, arguments, words):
    assert main(["optimise", str(capture.path), "-o", str(tmp_path / "run"), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
