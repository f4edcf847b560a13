"""Relighting as a whole on small captures, the diffuse mesh on its own, and what is refused."""

import json
import shutil

import pytest

from ndf_mi import commands
from ndf_mi.field import preset
from ndf_mi.learn.loop import start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import relightable
from ndf_mi.surface import texture_fit as mesh_fit


@pytest.fixture
def captures(make_constant_run, lit_capture):
    truth = make_constant_run(25.0, srgb=(0.9, 0.7, 0.5), name="truth", direction_octaves=-1, normal_octaves=-1)
    return lit_capture(truth, "day"), lit_capture(truth, "night")


@pytest.fixture
def trained(captures, tmp_path):
    tiny, _ = relightable(preset("tiny"))
    options = TrainingOptions(steps=4, warm_up=2, rays=64, samples=16, paths=2, max_depth=4, cell=0.03, integrator="prbvolpath")
    train(start(tmp_path / "run", captures[0], tiny, options), quiet=True)
    return tmp_path / "run"


@pytest.fixture
def quick(monkeypatch):
    for name, value in (("SWEEP_STEPS", 2), ("WINDOW_STEPS", 4), ("MAX_STEPS", 8), ("RATES", (3e-2, 1e-1))):
        monkeypatch.setattr(mesh_fit, name, value)
    # The default of an argument.
    monkeypatch.setattr(mesh_fit.TextureFit.to_convergence, "__defaults__", (None, 8))


def call(run, capture, under, out, *more):
    return commands.main(["relight", str(run), "--capture", str(capture.path), "--under", str(under.path), "-o", str(out),
                          "--spp", "8", "--texture", "16", *more])


@pytest.mark.long
def test_it_measures_both_under_both_lights_and_keeps_what_is_there(captures, trained, quick, tmp_path, capsys):
    out = tmp_path / "out"
    assert call(trained, *captures, out) == 0
    said = capsys.readouterr().out
    assert "Seen light, novel views" in said and "Unseen light, novel views" in said and "Noise of the pictures" in said
    documents = {name: json.loads((out / f"{name}.json").read_text()) for name in ("seen", "unseen")}
    for document in documents.values():
        assert [method["key"] for method in document["methods"]] == ["ndf", "mesh"]
        assert all(len(method["images"]) == 1 for method in document["methods"])
    report = (out / "report.html").read_text()
    assert "Under the seen light" in report and "Under the unseen light" in report and report.count("data:image/png") >= 10
    stamp = (out / "relight" / "mesh" / "mesh.safetensors").stat().st_mtime_ns
    pictures = {file: file.stat().st_mtime_ns for file in out.rglob("*.png")}
    assert call(trained, *captures, out) == 0
    assert (out / "relight" / "mesh" / "mesh.safetensors").stat().st_mtime_ns == stamp
    assert {file: file.stat().st_mtime_ns for file in out.rglob("*.png")} == pictures


@pytest.mark.long
def test_captures_that_do_not_belong_are_refused(captures, trained, make_run, tmp_path, capsys):
    day, night = captures
    out = tmp_path / "out"
    # One that ended before scattering began.
    early = shutil.copytree(trained, tmp_path / "early")
    config = json.loads((early / "config.json").read_text())
    config["trained"]["steps"] = 2
    (early / "config.json").write_text(json.dumps(config))
    for arguments, words in (
        ((trained, night, day), ["the one that"]),
        ((trained, day, day), ["in another light"]),
        ((make_run("other").path, day, night), ["training.integrator", "prbvolpath"]),
        ((tmp_path / "nothing", day, night), ["config.json"]),
        ((early, day, night), ["trained.steps", "more than the 2 steps by quadrature", "warm_up"]),
    ):
        assert call(*arguments, out) == 2
        said = capsys.readouterr().err
        assert all(word in said for word in words), said
    assert call(trained, day, night, out, "--spp", "7") == 2
    assert call(trained, day, night, out, "--lattice", "-1") == 2
    assert not out.exists()
