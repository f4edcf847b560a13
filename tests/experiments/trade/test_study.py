"""The study of the trade: every point measured once, stopped and gone on with, and a report of it."""

import csv
import json

import numpy as np
import pytest

from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.experiments.trade import points, study
from ndf_mi.experiments.trade.study import PICTURES, REPORT, RESULTS, TABLE, Settings, TradeStudy
from ndf_mi.field import Preset
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.reports.tradeoff import groups, markdown

KEYS = {"usual", "samples-8", "size-0.5"}
SETTINGS = Settings(("samples", "size", "width"), steps=2, views=1, timed=1, repeats=2)


@pytest.fixture
def few(monkeypatch):
    """Fewer points than there are."""
    drawn, trained = points.rendering_points, points.variants_of
    monkeypatch.setattr(points, "rendering_points", lambda preset: [p for p in drawn(preset) if p.key in KEYS])
    monkeypatch.setattr(points, "variants_of", lambda *a: [v for v in trained(*a) if v.key in ("own", "width-0.5")])


def make(run, capture, folder, settings=SETTINGS):
    return TradeStudy(run.path, capture.path, folder, settings, "ndf-mi tradeoff …")


def silent(*_):
    """Listens to nothing."""


def test_measures_every_point_once_and_goes_on_where_it_was(trained_run, capture, tmp_path, few, monkeypatch):
    told = []

    def stop(text, number, of):
        told.append(text)
        if text == "timing" and number == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(trained_run, capture, tmp_path).run(stop)
    assert [text for text in told if text.startswith("training")] == ["training tiny, as it is", "training layers of 8"]
    assert sum(text.startswith("drawing") for text in told) == 5
    again = []
    trade = make(trained_run, capture, tmp_path).run(lambda text, number, of: again.append((text, number)))
    assert again == [("compiling", 1), ("timing", 2)]
    assert [row.key for row in trade.rows] == ["usual", "samples-8", "size-0.5", "own", "width-0.5"]
    for row in trade.rows:
        assert len(row.seconds) == 2 and row.memory > 0 and len(row.figures) == 2
        assert row.metadata["parameters"] > 0
    fewer = trade.row("samples-8")
    # What eight samples miss is error of rendering, and the model's error is that of the same field in both.
    assert fewer.converged() < trade.row("usual").converged()
    assert fewer.model() == trade.row("usual").model()
    own, narrow = trade.row("own").metadata, trade.row("width-0.5").metadata
    assert narrow["steps"] == 2 and narrow["parameters"] < own["parameters"]

    page = (tmp_path / REPORT).read_text()
    assert page.count("<svg") == len(groups(trade)) == 3 and page.count("<img") >= 12
    assert (tmp_path / "table.md").read_text() == markdown(trade)
    with open(tmp_path / TABLE, newline="") as file:
        table = list(csv.DictReader(file))
    assert [line["point"] for line in table] == [row.key for row in trade.rows]
    assert float(table[1]["seconds_a_frame"]) == np.median(fewer.seconds) and table[1]["samples"] == "8"

    # All is there: nothing is trained, drawn or timed again.
    make(trained_run, capture, tmp_path).run(lambda *_: pytest.fail("done again"))


@pytest.mark.parametrize(("key", "timed"), [("fingerprint", ["compiling", "timing"]), ("under", [])])
def test_a_point_is_measured_anew_where_what_it_depends_on_has_changed(trained_run, capture, tmp_path, few, key, timed):
    settings = Settings(("samples",), views=1, timed=1, repeats=1)
    make(trained_run, capture, tmp_path, settings).run(silent)
    document = json.loads((tmp_path / RESULTS).read_text())
    document["points"][1][key] = "another"
    (tmp_path / RESULTS).write_text(json.dumps(document))
    told = []
    make(trained_run, capture, tmp_path, settings).run(lambda text, *_: told.append(text))
    # Repeats are of all points together, and void where machine or sources are others, which what was timed tells for itself.
    assert told == ["drawing 8 samples", *timed]


def only(monkeypatch, *keys):
    """Fewer points than there are: those, and no field trained."""
    drawn = points.rendering_points
    monkeypatch.setattr(points, "rendering_points", lambda preset: [p for p in drawn(preset) if p.key in keys])


def test_points_with_other_rays_a_pixel_are_held_against_other_pictures(trained_run, capture, tmp_path, monkeypatch):
    only(monkeypatch, "usual", "rays-2")
    monkeypatch.setattr("ndf_mi.render.settings.CONVERGED_SAMPLES", 64)
    settings = Settings(("rays",), views=1, timed=1, repeats=1)
    trade = make(trained_run, capture, tmp_path, settings).run(silent)
    usual, rays = trade.row("usual"), trade.row("rays-2")
    assert (usual.reference, rays.reference) == ("run-converged-1", "run-converged-2")
    view = usual.figures[0].view

    def pictures():
        return [(tmp_path / PICTURES / row.reference / view.file).read_bytes() for row in (usual, rays)]

    first = pictures()
    assert first[0] != first[1]
    # A folder that lacks them, or has them under another name, is completed: nothing is measured or timed again.
    for row in (usual, rays):
        (tmp_path / PICTURES / row.reference / view.file).unlink()
    make(trained_run, capture, tmp_path, settings).run(lambda *_: pytest.fail("done again"))
    assert pictures() == first


def test_what_was_measured_of_other_axes_stays(trained_run, capture, tmp_path, few):
    settings = {axes: Settings(axes, steps=2, views=1, timed=1, repeats=1) for axes in (("samples", "width"), ("size",))}
    first = make(trained_run, capture, tmp_path, settings["samples", "width"]).run(silent)
    told = []
    second = make(trained_run, capture, tmp_path, settings["size",]).run(lambda text, *_: told.append(text))
    assert told == ["drawing 0.5 of the width and height", "compiling", "timing"]
    assert {row.key for row in second.rows} == {"usual", "size-0.5", "samples-8", "own", "width-0.5"}
    for key in ("samples-8", "own", "width-0.5"):
        assert second.row(key) == first.row(key)
    # Two sessions of timing: what they timed is told apart, and only the rows of one were timed in turns.
    assert len({row.session for row in second.rows}) == 2 and second.row("usual").session == second.row("size-0.5").session
    text = markdown(second)
    assert text.count("†") == 4 and "| 8 samples † |" in text and "not in turns" in text and "†" not in markdown(first)
    assert {row.key for group in groups(second) for row in group.rows} == {row.key for row in second.rows}
    assert "†" in (tmp_path / REPORT).read_text()
    # What a field that is gone, or of no use, was measured with does not hold any more.
    (tmp_path / "fields" / "own" / "config.json").write_text("{")
    other = make(trained_run, capture, tmp_path, settings["size",])
    assert {row.key for row in other.run(silent).rows} == {"usual", "size-0.5", "samples-8", "width-0.5"}


def test_rows_of_another_machine_are_shown_and_not_compared(trained_run, capture, tmp_path, few, monkeypatch):
    make(trained_run, capture, tmp_path, Settings(("samples",), views=1, timed=1, repeats=1)).run(silent)
    described = study.machine.describe()
    monkeypatch.setattr(study.machine, "describe", lambda: described | {"Processor": "another"})
    trade = make(trained_run, capture, tmp_path, Settings(("size",), views=1, timed=1, repeats=1)).run(silent)
    assert "samples-8" in {row.key for row in trade.rows}
    assert "samples-8" not in {row.key for group in groups(trade) for row in group.rows}
    assert "another machine" in markdown(trade)


def test_a_folder_of_before_rows_knew_their_session_is_gone_on_with(trained_run, capture, tmp_path, few):
    settings = Settings(("samples",), views=1, timed=1, repeats=1)
    make(trained_run, capture, tmp_path, settings).run(silent)
    document = json.loads((tmp_path / RESULTS).read_text())
    document["about"]["timing"] = document["about"].pop("sessions")[document["about"].pop("session")]
    for row in document["points"]:
        del row["session"]
    (tmp_path / RESULTS).write_text(json.dumps(document))
    make(trained_run, capture, tmp_path, settings).run(lambda *_: pytest.fail("done again"))


def test_a_plan_that_leaves_layers_out_has_all_of_the_points():
    planned = Preset(pose_layers=(), deformation_layers=(), colour_layers=(), feature_width=0, direction_octaves=-1)
    keys = [point.key for point in points.rendering_points(planned)]
    # Without a view direction in its colours it can be put onto a lattice, too.
    full = [point.key for point in points.rendering_points(Preset())]
    assert [key for key in keys if "lattice" not in key] == full and "usual" in keys and len(keys) > len(full)
    variants = points.variants_of(planned, TrainingOptions())
    assert variants[0].preset == planned and {"width-0.5", "width-2"} < {v.key for v in variants}
    assert all(v.preset.colour_layers == () for v in variants if v.axis in ("band", "width", "encoding"))


@pytest.mark.long
def test_path_tracing_is_a_trade_of_its_own(trained_run, capture, tmp_path, monkeypatch):
    drawn = points.rendering_points
    keys = ("usual", "path-2", "path-shell", "path-lattice-12-8")
    monkeypatch.setattr(points, "rendering_points", lambda preset: [p for p in drawn(preset) if p.key in keys])
    monkeypatch.setattr("ndf_mi.experiments.trade.drawing.CONVERGED_SPP", 32)
    monkeypatch.setattr("ndf_mi.experiments.trade.paths.LAYERS", 1)
    trade = make(trained_run, capture, tmp_path, Settings(("path",), views=1, timed=1, repeats=1, path_size=12)).run(silent)
    few, shell, lattice = trade.row("path-2"), trade.row("path-shell"), trade.row("path-lattice-12-8")
    # A field trained by quadrature is lit twice by paths: the truth says nothing about it.
    assert few.truth() is None and few.converged() < shell.converged()
    assert few.metadata["loading"] > 0 and len(few.figures) == 1
    assert few.converged() < lattice.converged() and "lattice" not in few.setting
    assert [group.title for group in groups(trade)][-1] == "Path tracing"


@pytest.mark.parametrize(("options", "words"), [
    (["--only", "colour"], "samples"),
    (["--repeats", "0"], "repeats"),
    (["--seconds", "0"], "seconds"),
    (["--views", "0"], "views"),
])
def test_mistakes_are_told_with_exit_code_2(trained_run, capture, tmp_path, capsys, options, words):
    out = tmp_path / "out"
    assert main(["tradeoff", str(trained_run.path), "--capture", str(capture.path), "-o", str(out), *options]) == 2
    assert words in capsys.readouterr().err and not out.exists()


def test_a_run_of_another_capture_is_refused(trained_run, write_capture, tmp_path):
    with pytest.raises(InputError, match="the one that"):
        TradeStudy(trained_run.path, write_capture("other"), tmp_path / "out", SETTINGS, "…")
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / study.RESULTS).write_text("{")
    with pytest.raises(InputError, match="Remove it"):
        TradeStudy(trained_run.path, trained_run_capture(trained_run, write_capture), tmp_path / "out", SETTINGS, "…")


def trained_run_capture(run, write_capture):
    """The folder of the capture that the run was trained on, under the same name."""
    return write_capture(run.config["capture"]["name"])
