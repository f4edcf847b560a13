"""Relighting as a whole on small captures, and what is refused."""

from __future__ import annotations

import json
import shutil

import pytest

from ndf_mi.commands import main
from ndf_mi.field import preset
from ndf_mi.learn.loop import start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import relightable
from ndf_mi.surface import schedule


@pytest.fixture
def captures(make_constant_run, lit_capture):
    truth = make_constant_run(
        25.0, srgb=(0.9, 0.7, 0.5), name="truth", direction_octaves=-1, normal_octaves=-1
    )
    return lit_capture(truth, "day"), lit_capture(truth, "night")


@pytest.fixture
def trained(captures, tmp_path):
    tiny, _ = relightable(preset("tiny"))
    options = TrainingOptions(surface="body",
        steps=4, warm_up=2, rays=64, samples=16, paths=2, max_depth=4, cell=0.03, integrator="prbvolpath"
    )
    train(start(tmp_path / "run", captures[0], tiny, options), quiet=True)
    return tmp_path / "run"


@pytest.fixture
def quick(monkeypatch):
    """A short schedule for the mesh's fit; schedules have tests of their own."""
    short = schedule.Schedule(texture_rates=(3e-2, 1e-1), search_steps=2, window_steps=4, max_steps=8)
    monkeypatch.setattr(schedule, "DEFAULT", short)


def call(run, capture, under, out, *more):
    return main(
        [
            "relight", str(run), "--capture", str(capture.path), "--under", str(under.path), "-o", str(out),
            "--spp", "8", "--texture", "16", *more,
        ]
    )


@pytest.mark.long
def test_it_measures_both_under_both_lights_and_keeps_what_is_there(
    captures, trained, quick, tmp_path, capsys
):
    out = tmp_path / "out"
    assert call(trained, *captures, out) == 0
    printed = capsys.readouterr().out.lower()
    assert all(words in printed for words in ("seen", "unseen", "novel views", "noise"))
    for name in ("seen", "unseen"):
        document = json.loads((out / f"{name}.json").read_text())
        assert [method["key"] for method in document["methods"]] == ["ndf", "mesh"]
        assert all(method["metadata"]["noise_psnr"] > 10 for method in document["methods"])
        images = [key for key in document["records"] if "/image/" in key]
        assert len(images) == 2 and all(document["records"][key]["value"]["noise"] for key in images)
    report = (out / "report.html").read_text()
    assert "unseen" in report and report.count("data:image/png") >= 10
    stamps = {
        file: file.stat().st_mtime_ns for pattern in ("*.png", "*.safetensors") for file in out.rglob(pattern)
    }
    assert call(trained, *captures, out) == 0
    assert {file: file.stat().st_mtime_ns for file in stamps} == stamps


@pytest.mark.long
def test_captures_and_runs_that_do_not_belong_together_are_refused(
    captures, trained, make_run, tmp_path, capsys
):
    day, night = captures
    out = tmp_path / "out"
    # A run that ended before scattering began.
    early = shutil.copytree(trained, tmp_path / "early")
    config = json.loads((early / "config.json").read_text())
    config["trained"]["steps"] = 2
    (early / "config.json").write_text(json.dumps(config))
    for arguments, words in (
        ((trained, night, day), ["trained on"]), ((trained, day, day), ["in another light"]),
        ((make_run("other").path, day, night), ["training.integrator", "prbvolpath"]),
        ((tmp_path / "nothing", day, night), ["config.json"]),
        ((early, day, night), ["trained.steps", "warm_up"]),
    ):
        assert call(*arguments, out) == 2
        text = capsys.readouterr().err
        assert all(word in text for word in words), text
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--spp", "7"], ["spp"]), (["--grid-spacing", "-1"], ["grid-spacing"]),
        (["--lattice", "-1"], ["grid-spacing", "deprecated"]), (["--max-images", "0"], ["max-images"]),
        (["--texture", "0"], ["texture"]), (["--seed", "-1"], ["seed"]),
    ],
)
def test_settings_are_checked_before_anything_is_read(tmp_path, capsys, options, words):
    nowhere = str(tmp_path / "nowhere")
    assert main(["relight", nowhere, "--capture", nowhere, "--under", nowhere, "-o", nowhere, *options]) == 2
    text = capsys.readouterr().err
    assert all(word in text for word in words) and not (tmp_path / "nowhere").exists()
