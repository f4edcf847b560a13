"""The report on relighting."""

import copy

import pytest
from parsed_page import ParsedPage

from ndf_mi.reports.relight import notes, table, write_relight_report


@pytest.fixture
def lights(results):
    """The same figures under both lights."""
    results.methods[0].metadata["noise_psnr"] = 38.25
    results.about["settings"] = {"grid_spacing": 0.006}
    for method in results.methods:
        method.images = [image for image in method.images if image.view.split != "train"]
    return {"seen": results, "unseen": copy.deepcopy(results)}


def test_a_table_and_pictures_under_each_light(lights, truth, tmp_path):
    lights["unseen"].about["capture"]["path"] = "captures/night"
    write_relight_report(
        tmp_path / "report.html", lights, dict.fromkeys(lights, truth), dict.fromkeys(lights, tmp_path)
    )
    page = ParsedPage(tmp_path / "report.html")
    assert len(page.alts) == 2 * 3 * 7
    assert {(2, "Under the seen light"), (2, "Under the unseen light")} <= set(page.headings)
    assert page.tables[0][0][1:] == [
        f"{light} light, {split}" for light in ("Seen", "Unseen") for split in ("novel views", "novel poses")
    ]
    for text in (
        "captures/dancer",
        "captures/night",
        "38.2 dB under the unseen light",
        "6 mm",
        "Learning rate 0.1.",
    ):
        assert text in page.text, text


def test_what_the_terminal_prints(lights):
    assert len(list(table(lights).parts())) == 4
    assert any("38.2 dB under the seen light" in note for note in notes(lights))
    lights["seen"].about["settings"] = {}
    lights["seen"].methods.pop(0), lights["unseen"].methods.pop(0)
    assert len(notes(lights)) == 1
