"""The whole comparison: a run, the meshes, the results and what a second call does."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.commands import main
from ndf_mi.commands.compare import Compare
from ndf_mi.commands.compare_console import print_tables
from ndf_mi.errors import InputError
from ndf_mi.experiments import compare as comparison
from ndf_mi.experiments import metrics
from ndf_mi.experiments.compare import Comparison, Settings
from ndf_mi.field import PRESETS
from ndf_mi.run import Run
from ndf_mi.surface import offset_fit
from ndf_mi.surface import texture_fit as mesh_fit

SETTINGS = Settings(max_images=1, texture=32, samples=16, sequence=0)


class Watcher:
    """Counts what it is told."""

    def __init__(self) -> None:
        self.trained: set[str] = set()
        self.measured_images: list[tuple[str, int, int]] = []

    def training(self, label, seconds, budget, step, loss):
        self.trained.add(label)

    def measured(self, label, done, of):
        self.measured_images.append((label, done, of))


@pytest.fixture(scope="module")
def run(capture, tmp_path_factory):
    """An untrained field that says it was trained for an hour on the capture."""
    path = tmp_path_factory.mktemp("run")
    made = Run.create(
        path,
        PRESETS["tiny"],
        capture.body,
        capture.poses,
        seed=0,
        background=capture.background.tolist(),
        capture={"name": capture.name, "digest": capture.digest},
        trained={"steps": 10, "seconds": 3600.0, "done": True},
    )
    made.save()
    rows = [{"step": s, "seconds": float(s), "loss": 0.1 / s, "psnr": 10.0 + s, "samples": 5} for s in (5, 10)]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows) + '{"step": 1', encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def short_sweep(monkeypatch):
    """Fewer rates and an early end: schedules have tests of their own."""
    monkeypatch.setattr(mesh_fit, "RATES", (0.03, 0.1))
    monkeypatch.setattr(mesh_fit, "SWEEP_STEPS", 4)
    monkeypatch.setattr(mesh_fit, "WINDOW_STEPS", 4)
    monkeypatch.setattr(mesh_fit, "TOLERANCE", 0.3)
    monkeypatch.setattr(offset_fit, "OFFSET_RATES", (2e-3, 8e-3))
    monkeypatch.setattr(offset_fit, "CONTOUR_SAMPLES", 256)


def compared(run, capture, folder, settings=SETTINGS):
    watcher = Watcher()
    return Comparison(run, capture.path, folder, settings, "ndf-mi compare").run(watcher), watcher


def test_compares_once_and_goes_on_where_it_was(run, capture, tmp_path, monkeypatch, capsys):
    # Convergence is faster than an hour, so one mesh of each kind stands for both times.
    first, watcher = compared(run, capture, tmp_path)
    assert watcher.trained == {"mesh to convergence", "mesh with offsets to convergence"}
    assert [method.key for method in first.methods] == ["ndf", "mesh-converged", "offset-mesh-converged"]
    assert first.methods[1].metadata["rate"] == first.methods[2].metadata["rate"] and not first.methods[2].metadata["sweep"]
    assert len(watcher.measured_images) == 3 * 3 and watcher.measured_images[-1][1:] == (3, 3)
    assert first.methods[1].mean("novel_view", "box_psnr") > first.methods[0].mean("novel_view", "box_psnr")
    assert (tmp_path / "report.html").stat().st_size > 10_000
    document = json.loads((tmp_path / "compare.json").read_text())
    assert set(document["methods"][0]["means"]["novel_pose"]) == set(metrics.LABELS)

    again, watcher = compared(run, capture, tmp_path)
    assert not watcher.trained and not watcher.measured_images
    assert [method.images for method in again.methods] == [method.images for method in first.methods]

    # A time that is asked for is trained for, with the rates that the sweeps found.
    timed, watcher = compared(run, capture, tmp_path, replace(SETTINGS, mesh_seconds=0.5))
    assert watcher.trained == {"mesh of equal time", "mesh with offsets of equal time"}
    kinds = [f"{kind}-{end}" for kind in ("mesh", "offset-mesh") for end in ("equal-time", "converged")]
    assert [method.key for method in timed.methods] == ["ndf", *kinds]
    for equal, converged in (timed.methods[1:3], timed.methods[3:5]):
        assert equal.metadata["budget"] == 0.5 and equal.metadata["rate"] == converged.metadata["rate"]
        assert equal.metadata.get("offset_rate") == converged.metadata.get("offset_rate")
    assert {label for label, _, _ in watcher.measured_images} == {"Mesh, equal time", "Mesh with offsets, equal time"}

    print_tables(timed)
    printed = capsys.readouterr().out
    assert "Novel views" in printed and "Mesh, equal time" in printed and "Box PSNR (dB)" in printed


def test_offsets_for_the_equal_time_or_not_at_all(run, capture, tmp_path):
    plain, watcher = compared(run, capture, tmp_path, replace(SETTINGS, offsets="none"))
    assert [method.key for method in plain.methods] == ["ndf", "mesh-converged"]
    settings = replace(SETTINGS, mesh_seconds=0.5, offsets="equal-time")
    timed, watcher = compared(run, capture, tmp_path, settings)
    assert watcher.trained == {"mesh of equal time", "mesh with offsets of equal time"}
    keys = ["ndf", "mesh-equal-time", "mesh-converged", "offset-mesh-equal-time"]
    assert [method.key for method in timed.methods] == keys


def test_an_interrupted_comparison_keeps_what_it_has(run, capture, tmp_path, monkeypatch):
    class Interrupting(Watcher):
        def measured(self, label, done, of):
            if done == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Comparison(run, capture.path, tmp_path, SETTINGS, "").run(Interrupting())
    assert not (tmp_path / "report.html").exists()
    _, watcher = compared(run, capture, tmp_path)
    assert not watcher.trained
    assert [done for label, done, _ in watcher.measured_images if label == "NDF"] == [3]


def test_another_capture_is_refused(run, write_capture, tmp_path):
    with pytest.raises(InputError, match="trained on"):
        Comparison(run, write_capture("other"), tmp_path, SETTINGS, "")
    assert not any(tmp_path.iterdir())


def test_not_a_run(capture, tmp_path):
    with pytest.raises(InputError, match="config.json"):
        Comparison(tmp_path, capture.path, tmp_path / "out", SETTINGS, "")


def test_a_run_without_training_time_needs_the_option(run, capture, tmp_path, monkeypatch):
    config = json.loads((run / "config.json").read_text())
    files.write_json(run / "config.json", {key: value for key, value in config.items() if key != "trained"})
    try:
        with pytest.raises(InputError, match="--mesh-seconds"):
            Comparison(run, capture.path, tmp_path, SETTINGS, "")
        Comparison(run, capture.path, tmp_path, replace(SETTINGS, mesh_seconds=1.0), "")
    finally:
        files.write_json(run / "config.json", config)


def test_a_run_that_went_on_for_a_moment_keeps_its_meshes(run, capture, tmp_path):
    config = json.loads((run / "config.json").read_text())

    def of(seconds, **given):
        files.write_json(run / "config.json", {**config, "trained": {**config["trained"], "seconds": seconds}})
        return compared(run, capture, tmp_path, replace(SETTINGS, offsets="equal-time", **given))[1].trained

    try:
        # Of the mesh with offsets alone: whether the other one converges within the time depends on the machine.
        timed = "mesh with offsets of equal time"
        assert timed in of(0.5)
        assert timed not in of(0.504)
        assert timed in of(0.504, mesh_seconds=0.504)
        assert timed in of(0.6)
    finally:
        files.write_json(run / "config.json", config)


@pytest.mark.parametrize(
    "option",
    [
        {"max_images": 0},
        {"texture": 0},
        {"samples": -1},
        {"mesh_seconds": 0.0},
        {"seed": -1},
        {"sequence": 1},
        {"offsets": "some"},
    ],
)
def test_options_are_checked(option):
    with pytest.raises(InputError, match="option"):
        Settings(**option)


def test_command_repeats_itself(tmp_path):
    command = Compare(tmp_path / "run", tmp_path / "capture", max_images=3, out=tmp_path / "out")
    arguments = command._arguments()
    assert arguments[:4] == ["compare", str(tmp_path / "run"), "--capture", str(tmp_path / "capture")]
    assert arguments[4:] == ["--out", str(tmp_path / "out"), "--max-images", "3"]


def test_folder_with_something_else_is_refused(run, capture, tmp_path):
    (tmp_path / comparison.RESULTS).write_text("{}")
    with pytest.raises(InputError, match="compare.json"):
        Comparison(run, capture.path, tmp_path, SETTINGS, "")


def test_mistakes_leave_with_exit_code_2_and_nothing_written(capture, tmp_path, capsys):
    arguments = ["compare", str(tmp_path / "absent"), "--capture", str(capture.path), "-o", str(tmp_path / "out")]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert "absent" in said and "expected" in said and "Traceback" not in said
    assert not (tmp_path / "out").exists()


def test_a_split_of_successive_frames_is_measured_and_shown(run, capture, tmp_path):
    folder, own = tmp_path / "capture", tmp_path / "run"
    shutil.copytree(capture.path, folder)
    shutil.copytree(run, own)
    document = json.loads((folder / "capture.json").read_text())
    document["splits"]["sequence"] = {"cameras": ["n0"], "frames": [2, 5, 7]}
    (folder / "capture.json").write_text(json.dumps(document))
    config = json.loads((own / "config.json").read_text())
    config["capture"]["digest"] = Capture.read(folder).digest
    (own / "config.json").write_text(json.dumps(config))
    settings = replace(SETTINGS, sequence=3, offsets="none")
    results = Comparison(own, folder, tmp_path / "out", settings, "ndf-mi compare").run(Watcher())
    assert results.about["measured"] == {"novel_view": 1, "novel_pose": 1, "sequence": 3, "train": 1}
    field = results.methods[0]
    assert field.mean("sequence", "box_psnr") is not None and field.mean("sequence", "box_tpsnr") is not None
    assert field.mean("novel_view", "box_tpsnr") is None
    page = (tmp_path / "out" / "report.html").read_text()
    assert "3 of successive frames" in page and "means over 3 images, of tPSNR over 2 pairs of frames" in page
