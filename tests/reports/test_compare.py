"""The report of a comparison."""

import pytest
from parsed_page import ParsedPage

from ndf_mi.experiments import metrics
from ndf_mi.reports.compare import headline, write_report


@pytest.fixture
def page(results, truth, tmp_path):
    write_report(tmp_path / "report.html", results, truth, tmp_path)
    return ParsedPage(tmp_path / "report.html")


def test_all_methods_are_in_tables_pictures_charts_and_strips(results, page):
    # Truth, three methods and three error maps of four views; the truth's change and three errors of it in
    # two pairs of frames.
    assert len(page.alts) == 4 * 7 + 2 * 4
    assert len(page.charts) == 4
    for label in (method.label for method in results.methods):
        assert sum(any(row[0] == label for row in table) for table in page.tables) == 1 + 1 + 3
        assert sum(alt.startswith(f"{label}: ") for alt in page.alts) == 4
        assert f"{label}: " in page.charts[0]
    assert all("Mesh, to convergence: 12.5, 40" in chart for chart in page.charts[1:3])
    assert "NDF: from" in page.charts[3]
    assert "Which one for whom" in page.text and "Next is NDF, 20.00 dB behind" in page.text


def test_figures_and_circumstances_are_printed(page):
    for text in (
        "20.00",
        "40.00",
        "∞",
        "NDF − Mesh, to convergence",
        "−20.00",
        "runs/a<b",
        "12 s",
        "1 min 01 s",
        "dancer",
        "texture 64",
        "Protocol default: All images.",
        "means over 2 images",
        "means over 1 image;",
        "tPSNR over 2 pairs",
    ):
        assert text in page.text, text
    assert "A note on the protocol." in page.text and "<code>note</code>" in page.source


def test_the_protocol_leads_the_table(results, page):
    assert headline(results, ["novel_view"]).columns == ("Box PSNR (dB)", "Box FLIP")
    assert page.tables[0][1] == ["Method", *2 * ["Box PSNR (dB)", "Box FLIP"]]


def test_matched_colours_lead_only_after_training_with_camera_colours(results, truth, tmp_path):
    results.methods[1].metadata["training"] = {"camera_colours": True}
    columns = headline(results, ["novel_view"]).columns
    assert columns == ("Box PSNR (dB)", "Box PSNR, colours matched (dB)", "Box FLIP")


def test_lpips_is_shown_where_it_was_measured_and_its_absence_said_where_not(results, page, truth, tmp_path):
    assert "LPIPS is not measured" in page.text and "Box LPIPS" not in page.text
    for image in (image for method in results.methods for image in method.images):
        image.figures[metrics.LPIPS] = 0.25
    assert headline(results, ["novel_view"]).columns[-1] == "Box LPIPS"
    write_report(tmp_path / "report.html", results, truth, tmp_path)
    text = ParsedPage(tmp_path / "report.html").text
    assert "0.2500" in text and "LPIPS is not" not in text


def test_older_comparisons_have_no_matched_colours(results, truth, tmp_path):
    write_report(tmp_path / "report.html", results, truth, tmp_path)
    assert "colours matched" in ParsedPage(tmp_path / "report.html").text
    for image in (image for method in results.methods for image in method.images):
        image.figures.pop(metrics.MATCHED)
    write_report(tmp_path / "report.html", results, truth, tmp_path)
    assert "colours matched" not in ParsedPage(tmp_path / "report.html").text


def test_without_sequences_and_curves_their_parts_are_left_out(results, truth, tmp_path):
    for method in results.methods:
        method.flicker = []
        method.metadata.pop("history", None)
        method.metadata = {}
    write_report(tmp_path / "report.html", results, truth, tmp_path)
    page = ParsedPage(tmp_path / "report.html")
    assert not page.charts and len(page.alts) == 4 * 7 and "tPSNR over" not in page.text
