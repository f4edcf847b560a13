"""The study of the trade: every point is measured once; a stopped study continues."""

import csv
import json

import numpy as np
import pytest

from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.experiments.core import Progress
from ndf_mi.experiments.trade import points, study
from ndf_mi.experiments.trade.study import PICTURES, RESULTS, TABLE, Settings, TradeStudy
from ndf_mi.field import Preset
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.reports.tradeoff import groups, markdown

KEYS = {"usual", "samples-8", "size-0.5"}
SETTINGS = Settings(("samples", "size", "width"), steps=2, views=1, timed=1, repeats=2)


@pytest.fixture
def few(monkeypatch):
    """Fewer points than there are."""
    drawn, trained = points.rendering_points, points.variants_of
    monkeypatch.setattr(
        points, "rendering_points", lambda preset: [p for p in drawn(preset) if p.key in KEYS]
    )
    monkeypatch.setattr(
        points, "variants_of", lambda *a: [v for v in trained(*a) if v.key in ("own", "width-0.5")]
    )


def make(run, capture, folder, settings=SETTINGS):
    return TradeStudy(run.path, capture.path, folder, settings, "ndf-mi tradeoff …")


class Begun(Progress):
    """Keeps the labels of the units that were begun."""

    def __init__(self, stop_at=()):
        self.labels, self.stop_at = [], stop_at

    def begin(self, unit, number, of, why):
        self.labels.append(unit.label)
        if (unit.label, number) == self.stop_at:
            raise KeyboardInterrupt


def begun(study):
    """What a study does when it runs."""
    progress = Begun()
    study.run(progress)
    return progress.labels


def test_measures_every_point_once_and_continues_where_it_stopped(trained_run, capture, tmp_path, few):
    progress = Begun(("time all points", 2))
    with pytest.raises(KeyboardInterrupt):
        make(trained_run, capture, tmp_path).run(progress)
    assert progress.labels[:2] == ["train tiny, unchanged", "train layers of 8"]
    assert sum(label.startswith("render") for label in progress.labels) == 5
    study = make(trained_run, capture, tmp_path)
    assert begun(study) == ["time all points"]
    trade = study.trade
    assert [row.key for row in trade.rows] == ["usual", "samples-8", "size-0.5", "own", "width-0.5"]
    for row in trade.rows:
        assert len(row.seconds) == 2 and row.memory > 0 and len(row.figures) == 2
        assert row.metadata["parameters"] > 0
    fewer = trade.row("samples-8")
    # What eight samples miss is rendering error; the model's error is that of the same field in both.
    assert fewer.converged() < trade.row("usual").converged()
    assert fewer.model() == trade.row("usual").model()
    own, narrow = trade.row("own").metadata, trade.row("width-0.5").metadata
    assert narrow["steps"] == 2 and narrow["parameters"] < own["parameters"]
    assert len(groups(trade)) == 3
    with open(tmp_path / TABLE, newline="") as file:
        table = list(csv.DictReader(file))
    assert [line["point"] for line in table] == [row.key for row in trade.rows]
    assert float(table[1]["seconds_a_frame"]) == np.median(fewer.seconds) and table[1]["samples"] == "8"
    assert begun(make(trained_run, capture, tmp_path)) == []


@pytest.mark.parametrize("key", ["images", "environment"])
def test_a_point_is_measured_again_if_what_it_depends_on_has_changed(
    trained_run, capture, tmp_path, few, key
):
    settings = Settings(("samples",), views=1, timed=1, repeats=1)
    begun(make(trained_run, capture, tmp_path, settings))
    document = json.loads((tmp_path / RESULTS).read_text())
    document["records"]["draw/samples-8"]["inputs"][key] = "another"
    (tmp_path / RESULTS).write_text(json.dumps(document))
    # Timings are of all points together, and stale only if machine, code or the points themselves have
    # changed.
    assert begun(make(trained_run, capture, tmp_path, settings)) == ["render 8 samples"]


def only(monkeypatch, *keys):
    """Fewer points than there are: those, and no field trained."""
    drawn = points.rendering_points
    monkeypatch.setattr(
        points, "rendering_points", lambda preset: [p for p in drawn(preset) if p.key in keys]
    )


def test_points_with_other_rays_a_pixel_are_compared_with_other_pictures(
    trained_run, capture, tmp_path, monkeypatch
):
    only(monkeypatch, "usual", "rays-2")
    monkeypatch.setattr("ndf_mi.render.settings.CONVERGED_SAMPLES", 64)
    settings = Settings(("rays",), views=1, timed=1, repeats=1)
    trade = make(trained_run, capture, tmp_path, settings).run()
    usual, rays = trade.row("usual"), trade.row("rays-2")
    assert (usual.reference, rays.reference) == ("run-converged-1", "run-converged-2")
    view = usual.figures[0].view

    def pictures():
        return [(tmp_path / PICTURES / row.reference / view.file).read_bytes() for row in (usual, rays)]

    first = pictures()
    assert first[0] != first[1]
    # Missing ones are written again; nothing is measured or timed for that.
    for row in (usual, rays):
        (tmp_path / PICTURES / row.reference / view.file).unlink()
    assert begun(make(trained_run, capture, tmp_path, settings)) == [] and pictures() == first


def test_measurements_of_other_axes_stay(trained_run, capture, tmp_path, few):
    settings = {
        axes: Settings(axes, steps=2, views=1, timed=1, repeats=1)
        for axes in (("samples", "width"), ("size",))
    }
    first = make(trained_run, capture, tmp_path, settings["samples", "width"]).run()
    study = make(trained_run, capture, tmp_path, settings["size",])
    assert begun(study) == ["render 0.5 of the width and height", "time all points"]
    second = study.trade
    assert {row.key for row in second.rows} == {"usual", "size-0.5", "samples-8", "own", "width-0.5"}
    for key in ("samples-8", "own", "width-0.5"):
        assert second.row(key) == first.row(key)
    # Two timing sessions, which the table keeps apart: only the rows of one were timed in turns.
    assert (
        len({row.session for row in second.rows}) == 2
        and second.row("usual").session == second.row("size-0.5").session
    )
    assert markdown(second).count("†") >= 3 and "†" not in markdown(first)
    assert {row.key for group in groups(second) for row in group.rows} == {row.key for row in second.rows}
    # A field that cannot be read any more takes its row with it.
    (tmp_path / "fields" / "own" / "config.json").write_text("{")
    other = make(trained_run, capture, tmp_path, settings["size",])
    assert {row.key for row in other.run().rows} == {"usual", "size-0.5", "samples-8", "width-0.5"}


def test_rows_of_another_machine_are_shown_and_not_compared(trained_run, capture, tmp_path, few):
    make(trained_run, capture, tmp_path, Settings(("samples",), views=1, timed=1, repeats=1)).run()
    document = json.loads((tmp_path / RESULTS).read_text())
    for key, record in document["records"].items():
        if key.startswith("timing/"):
            record["value"]["machine"]["Processor"] = "another"
    (tmp_path / RESULTS).write_text(json.dumps(document))
    trade = make(trained_run, capture, tmp_path, Settings(("size",), views=1, timed=1, repeats=1)).run()
    assert "samples-8" in {row.key for row in trade.rows}
    assert "samples-8" not in {row.key for group in groups(trade) for row in group.rows}
    assert "another machine" in markdown(trade)


def test_a_plan_that_leaves_layers_out_has_all_of_the_points():
    planned = Preset(
        pose_layers=(), deformation_layers=(), colour_layers=(), feature_width=0, direction_octaves=-1
    )
    keys = [point.key for point in points.rendering_points(planned)]
    # Without a view direction in its colours it can be put onto a grid, too.
    full = [point.key for point in points.rendering_points(Preset())]
    assert [key for key in keys if "grid" not in key] == full and "usual" in keys and len(keys) > len(full)
    variants = points.variants_of(planned, TrainingOptions(surface="body"))
    assert variants[0].preset == planned and {"width-0.5", "width-2"} < {v.key for v in variants}
    assert all(v.preset.colour_layers == () for v in variants if v.axis in ("band", "width", "encoding"))


@pytest.mark.long
def test_path_tracing_is_a_trade_of_its_own(trained_run, capture, tmp_path, monkeypatch):
    only(monkeypatch, "usual", "path-2", "path-shell", "path-grid-12-8")
    monkeypatch.setattr("ndf_mi.experiments.trade.rendering.CONVERGED_SPP", 32)
    monkeypatch.setattr("ndf_mi.experiments.trade.paths.LAYERS", 1)
    trade = make(
        trained_run, capture, tmp_path, Settings(("path",), views=1, timed=1, repeats=1, path_size=12)
    ).run()
    few, shell, grid = trade.row("path-2"), trade.row("path-shell"), trade.row("path-grid-12-8")
    # A field trained by quadrature is lit twice by paths: the truth says nothing about it.
    assert few.truth() is None and few.converged() < shell.converged()
    assert few.metadata["loading"] > 0 and len(few.figures) == 1
    assert few.converged() < grid.converged() and "grid_spacing" not in few.setting
    assert [group.title for group in groups(trade)][-1] == "Path tracing"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--only", "colour"], "samples"), (["--repeats", "0"], "repeats"), (["--seconds", "0"], "seconds"),
        (["--views", "0"], "views"),
    ],
)
def test_mistakes_leave_with_exit_code_2(trained_run, capture, tmp_path, capsys, options, words):
    out = tmp_path / "out"
    assert (
        main(["tradeoff", str(trained_run.path), "--capture", str(capture.path), "-o", str(out), *options])
        == 2
    )
    assert words in capsys.readouterr().err and not out.exists()


def test_a_run_of_another_capture_is_refused(trained_run, write_capture, tmp_path):
    with pytest.raises(InputError, match="trained on"):
        TradeStudy(trained_run.path, write_capture("other"), tmp_path / "out", SETTINGS, "…")
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / study.RESULTS).write_text("{")
    with pytest.raises(InputError, match="Remove the file"):
        TradeStudy(
            trained_run.path, trained_run_capture(trained_run, write_capture), tmp_path / "out", SETTINGS, "…"
        )


def trained_run_capture(run, write_capture):
    """The folder of the capture that the run was trained on, under the same name."""
    return write_capture(run.config["capture"]["name"])
