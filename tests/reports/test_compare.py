"""Evaluation, results on disk and the report, with methods whose pictures are known."""

from __future__ import annotations

import base64
import copy
import io
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from ndf_mi.experiments.core import Silent
from ndf_mi.experiments.evaluate import ImageSet, choose_views, measure
from ndf_mi.experiments.flicker import choose_sequences
from ndf_mi.experiments.protocols import DEFAULT, ZJU
from ndf_mi.experiments.records import Measured, MethodResult, Results, View
from ndf_mi.experiments.store import Store
from ndf_mi.reports import pictures, tables
from ndf_mi.reports.compare import write_report


class Shifted:
    """The truth plus a constant: its PSNR is −20·log10 of the constant."""

    key, label = "shifted", "Shifted"

    def __init__(self, capture, shift: float, facts) -> None:
        self._capture = capture
        self._shift = shift
        self._facts = facts

    def render(self, camera, frame):
        return self._capture.image(camera.name, frame) + np.float32(self._shift)

    def metadata(self):
        return self._facts

    def cache_key(self):
        return f"shifted by {self._shift}"


def mesh_facts(budget):
    history = [[50, 3.0, 0.01], [100, 6.0, 0.005]]
    return {"budget": budget, "seconds": 12.5, "steps": 100, "converged": budget is None, "rate": 0.1,
            "sweep": {"0.1": 0.002, "0.3": 0.004}, "history": history}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the pictures are."""
    return tmp_path_factory.mktemp("pictures")


@pytest.fixture(scope="module")
def measured(capture, folder):
    views = choose_views(capture, 2)
    made = Results(
        {
            "run": "runs/a<b",
            "capture": {"name": capture.name, "digest": capture.digest, "train": {"cameras": 4, "frames": 2}},
            "measured": {split: sum(v.split == split for v in views) for split in capture.splits},
            "protocol": DEFAULT.metadata(None, capture),
            "equal_seconds": 61.0,
            "settings": {"texture": 64},
            "command": "ndf-mi compare 'runs/a<b'",
            "machine": {"Cores": "2"},
        }
    )
    for key, label, shift, facts in (
        ("ndf", "NDF", 0.01, {"seconds": 61.0, "steps": 1000}),
        ("mesh-equal-time", "Mesh, equal time", 0.1, mesh_facts(61.0)),
        ("mesh-converged", "Mesh, to convergence", 0.0, mesh_facts(None)),
    ):
        images, store = ImageSet(capture, views, choose_sequences(capture, 12)), Store(folder / "compare.json", "comparison")
        made.methods.append(measure(key, label, Shifted(capture, shift, facts), images, folder, store, Silent()))
    return made


@pytest.fixture
def results(measured):
    return copy.deepcopy(measured)


def test_figures_of_known_pictures(results):
    ndf, equal, converged = results.methods
    assert ndf.mean("novel_view", "box_psnr") == pytest.approx(40, abs=1e-3)
    assert equal.mean("novel_pose", "psnr") == pytest.approx(20, abs=1e-3)
    assert converged.mean("novel_view", "box_psnr") == math.inf
    assert converged.mean("novel_view", "box_ssim") == 1
    assert converged.mean("novel_view", "box_flip") == 0
    assert ndf.seconds_an_image() > 0


def test_differences_and_text():
    views = [View("novel_view", "c", i) for i in range(2)]
    keys = ("box_psnr", "box_flip")

    def method(label, *figures):
        images = [Measured(v, 1.0, dict(zip(keys, f, strict=True))) for v, f in zip(views, figures, strict=True)]
        return MethodResult(label, label, "", {}, images)

    made = Results({}, [method("A", (30, 0.1), (32, 0.2)), method("B", (27, 0.3), (27, None))])
    a, b, gap = tables.comparison([("", made, "novel_view")], keys).rows
    assert [c.text for c in a.cells] == ["31.00", "0.1500"] and all(c.best for c in a.cells)
    assert [c.text for c in b.cells] == ["27.00", "0.3000"]
    assert gap.difference and [c.text for c in gap.cells] == ["+4.00", "−0.1500"]
    assert tables.figure("psnr", math.inf) == "∞" and tables.figure("psnr", None) == "–"
    assert tables.signed("psnr", -math.inf) == "−∞"
    assert tables.difference(math.inf, math.inf) is None
    texts = [tables.duration(s) for s in (None, 0.417, 37.6, 364.8, 7790)]
    assert texts == ["–", "0.42 s", "38 s", "6 min 05 s", "2 h 09 min"]


class Page(HTMLParser):
    """Collects what tests ask of a page, and checks that elements close in order."""

    VOID = {"meta", "img", "br", "link", "use", "path", "rect", "polyline"}

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self.tags: set[str] = set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        values = dict(attributes)
        if tag == "img":
            self.sources.append(values["src"])
            assert values["alt"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_report_is_one_valid_file_with_the_pictures(results, capture, folder, tmp_path):
    results.methods[0].metadata["history"] = [[s, s, 0.1 / s] for s in range(1, 5)]
    write_report(tmp_path / "report.html", results, capture, folder)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert not page.open
    assert "script" not in page.tags and "link" not in page.tags
    assert not re.search(r'(src|href)="https?:', text)
    # Two views, two poses and one training view: truth, three methods and three error maps each. Two sequences of one pair of
    # frames: what changes in truth, and three methods' errors of it.
    assert len(page.sources) == 5 * 7 + 2 * 4
    for source in page.sources:
        picture = Image.open(io.BytesIO(base64.b64decode(source.removeprefix("data:image/png;base64,"))))
        assert picture.format == "PNG" and min(picture.size) > 10
    assert text.count("<svg") == 1 + 2
    assert "means over 2 images; tPSNR over 1 pair of frames" in page.text
    assert "Camera n0, 2 frames from 2 to 5." in page.text
    for expected in ("40.00", "20.00", "∞", "NDF − Mesh, equal time", "+20.00", "runs/a<b", "12 s", "1 min 01 s"):
        assert expected in page.text, expected


def test_a_mesh_that_converged_early_is_said_to_stand_for_equal_time(results, capture, folder, tmp_path):
    results.methods.pop(1)
    write_report(tmp_path / "report.html", results, capture, folder)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "result at equal time" in text and text.count("<svg") == 1 + 2


def test_a_report_without_sequences_has_no_section_for_them(results, capture, folder, tmp_path):
    for method in results.methods:
        method.flicker = []
    write_report(tmp_path / "report.html", results, capture, folder)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Temporal consistency" not in text


def test_the_protocol_leads_the_table_and_is_named(results, capture, folder, tmp_path):
    results.about["protocol"] = ZJU.metadata({"edge_kernel": 0}, capture)
    write_report(tmp_path / "report.html", results, capture, folder)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "Protocol zju: ZJU-MoCap" in page.text and "the run's kernel is 0" in page.text
    headline = page.text[page.text.index("Figures") : page.text.index("Pictures")].replace("\xa0", " ")
    assert "Box SSIM, data_range 2" in headline and "FLIP" not in headline


def test_error_scale_is_round_and_covers_the_errors():
    assert pictures.error_scale([np.zeros((4, 4))]) == 0.05
    assert pictures.error_scale([np.full((4, 4), 0.17)]) == 0.2
    assert pictures.error_scale([np.full((4, 4), 0.9)]) == 1.0
    dark, bright = pictures.error_map(np.array([[0.0, 0.2]]), 0.2)[0].astype(int)
    assert dark.sum() < 20 and bright.sum() > 600
