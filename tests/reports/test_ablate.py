"""The report of an ablation study, and how it is compared with the paper."""

import pytest
from parsed_page import ParsedPage

from ndf_mi.experiments.records import Measured, MethodResult, Results, View
from ndf_mi.reports.ablate import agreement, markdown, order, write_ablation_report


def result(key, view, pose):
    images = [
        Measured(View(split, "0", 0), 1.0, {"box_psnr": value})
        for split, value in (("novel_view", view), ("novel_pose", pose))
    ]
    return MethodResult(key, key, "", {}, images)


def test_agreement_is_of_directions():
    results = Results(
        {},
        [
            result("full", 30.0, 25.0),
            result("naked", 29.0, 26.0),
            result("no-deform", 29.9, 24.0),
            result("unsigned", 20.0, 20.0),
        ],
    )
    found = agreement(results, "naked", "novel_view")
    assert (
        found is not None
        and found.here == pytest.approx(-1.0)
        and found.paper == pytest.approx(-6.10)
        and found.agrees
    )
    assert not agreement(results, "naked", "novel_pose").agrees
    # The paper has 0.03 and 0.06 dB between them, which is level.
    assert (
        agreement(results, "no-deform", "novel_view").agrees
        and not agreement(results, "no-deform", "novel_pose").agrees
    )
    # The paper puts naked behind the others, which are level; so do novel views here, but not novel poses.
    assert order(results, "novel_view") == (2, 2) and order(results, "novel_pose") == (0, 2)
    # The paper has no such rows.
    assert (
        agreement(results, "unsigned", "novel_view") is None
        and agreement(results, "full", "novel_view") is None
    )
    assert order(results, "sequence") is None


@pytest.fixture
def variants(add_method, about):
    methods = [
        add_method("full", "full model", 0.01, steps=1000, seconds=61.0),
        add_method("naked", "naked model", 0.1, steps=1000),
        add_method("surprise", "a new variant", 0.05),
    ]
    return Results(about, methods)


def test_the_report_has_all_variants(variants, truth, tmp_path):
    write_ablation_report(tmp_path / "report.html", variants, truth, tmp_path)
    page = ParsedPage(tmp_path / "report.html")
    # Truth and three variants in two novel views and a novel pose.
    assert len(page.alts) == 3 * 4 and sum(alt.startswith("a new variant: ") for alt in page.alts) == 3
    rows = {row[0]: row[1:] for row in page.tables[0][2:]}
    assert rows["full model"] == ["40.00", "0.5000", "–", "", "", "40.00", "0.5000", "43.00", "", "", ""]
    assert rows["naked model"] == [
        "20.00",
        "0.5000",
        "–",
        "−20.00",
        "−6.10",
        "20.00",
        "0.5000",
        "23.00",
        "−20.00",
        "−1.70",
        "yes / yes",
    ]
    assert rows["a new variant"][3:5] == ["−13.98", ""] and rows["a new variant"][-1] == ""
    for text in (
        "1,000 training steps in 1 min 01 s",
        "1 of 1 pair",
        "A note on the protocol.",
        "2 of novel views",
        "steps 1000",
    ):
        assert text in page.text, text


def test_the_table_is_also_a_file(variants, truth, tmp_path):
    write_ablation_report(tmp_path / "report.html", variants, truth, tmp_path)
    lines = (tmp_path / "table.md").read_text(encoding="utf-8").splitlines()
    assert "\n".join(lines) + "\n" == markdown(variants)
    assert lines[0].startswith("| Variant | Novel views: PSNR | ") and lines[0].endswith("| agrees |")
    assert lines[-1] == "A `note` on the protocol."
