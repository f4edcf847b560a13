"""The report of a study of speed and accuracy."""

import pytest
from parsed_page import ParsedPage

from ndf_mi.reports.fronts import groups
from ndf_mi.reports.tradeoff import front_rows, markdown, table, write_trade_report


@pytest.fixture
def page(trade, truth, tmp_path):
    write_trade_report(tmp_path / "report.html", trade, truth, tmp_path)
    return ParsedPage(tmp_path / "report.html")


def test_the_report_has_every_front_and_every_point(trade, page):
    assert len(page.charts) == len(groups(trade)) == 4
    rows = {row[0]: row[1:] for row in page.tables[0][1:]}
    assert list(rows) == [row.label + " †" * (row.key == "elsewhere") for row in trade.rows]
    assert rows["usual samples"] == [
        "0.800",
        "0.400 – 1.200",
        "3",
        "30.00",
        "0.9000",
        "40.00",
        "31.00",
        "●",
        "",
        "",
    ]
    assert rows["slow samples"][7] == "" and rows["elsewhere samples †"][7] == ""
    assert (
        rows["wide samples"][8] == "500 steps, 12 s"
        and rows["path samples"][3] == "–"
        and rows["path samples"][9] == "0.50 s"
    )
    for text in (
        "runs/a<b",
        "tiny",
        "24 × 20 pixels",
        "1 of novel views, 1 of novel poses",
        "a constant environment",
        "1 of these were",
    ):
        assert text in page.text, text
    assert "<code>volpath</code>" in page.source


def test_pictures_of_every_group(trade, page):
    # Truth, the converged picture, three points, and an error of all but the truth; against convergence, no
    # error of it, either.
    assert len(page.alts) == 2 * ((2 + 3 + 4) + (1 + 3 + 3) + (1 + 2 + 2) + (1 + 1 + 1))


def test_the_table_is_also_a_file(trade, page, tmp_path):
    text = (tmp_path / "table.md").read_text(encoding="utf-8")
    assert (
        text == markdown(trade) and text.startswith(table(trade).markdown()) and "†" in text.splitlines()[-1]
    )
    trade.rows = [row for row in trade.rows if row.session == "now"]
    assert "†" not in markdown(trade)


@pytest.fixture
def rows(trade, truth, tmp_path):
    return {group.title: front_rows(group, truth, tmp_path / "pictures") for group in groups(trade)}


def labels(row):
    return [picture.label for panel in row.panels for picture in panel]


def test_the_ends_and_the_knee_are_shown_in_a_view_of_each_split(rows):
    assert [len(found) for found in rows.values()] == [2, 2, 2, 2]
    shown = ["Fastest: 8 samples", "Knee: 16 samples", "Best: usual samples"]
    first = labels(rows["Against the truth"][0])
    assert [label for label in first if not label.startswith("Error")] == ["Truth", "Converged", *shown]
    assert [label for label in first if label.startswith("Error")] == [
        f"Error: {label}" for label in ("Converged", *shown)
    ]
    # Each trained field has a converged picture of its own.
    assert "Converged" not in labels(rows["Other fields"][0])
    assert "Truth" not in labels(rows["Path tracing"][0]) and "Converged" in labels(rows["Path tracing"][0])


def test_errors_are_against_what_the_group_compares_with(rows):
    def errors(title):
        alts = [
            picture.alt
            for panel in rows[title][0].panels
            for picture in panel
            if picture.label.startswith("Error: Best")
        ]
        return float(alts[0].split("mean ")[1].split(",")[0])

    assert errors("Against the truth") == pytest.approx(0.1, abs=0.01)
    assert errors("Against convergence") == pytest.approx(0.05, abs=0.01)
