"""Tables and how figures are written."""

import math

import pytest

from ndf_mi.experiments.records import Measured, MethodResult, Results, View
from ndf_mi.reports import tables
from ndf_mi.reports.tables import Cell, Row, Table


@pytest.fixture
def table():
    rows = (
        Row("a|b", (Cell("1"), Cell("2", best=True), Cell("3"))),
        Row("c", (Cell("4"), Cell("5"), Cell("")), True),
    )
    return Table(("x", "y", "z"), rows, (("First", 2), ("", 1)), "What it shows", "Method")


def test_markdown_names_groups_and_escapes_bars(table):
    assert table.markdown().splitlines() == [
        "| Method | First: x | First: y | z |",
        "| --- | --- | --- | --- |",
        r"| a\|b | 1 | 2 | 3 |",
        "| c | 4 | 5 |  |",
    ]
    assert Table(("x",), ()).markdown() == "|  | x |\n| --- | --- |\n"


def test_parts_are_the_groups(table):
    first, second = table.parts()
    assert (
        first.caption == "First"
        and first.columns == ("x", "y")
        and [len(row.cells) for row in first.rows] == [2, 2]
    )
    assert second.columns == ("z",) and second.rows[1].label == "c" and second.rows[1].difference


def test_the_terminal_shows_all_of_it(table, capsys):
    tables.print_table(table, ["A note on [brackets]."])
    printed = capsys.readouterr().out
    for text in ("First", "Method", "x", "z", "a|b", "5", "A note on [brackets]."):
        assert text in printed


def test_a_comparison_has_means_bests_and_differences():
    views = [View("novel_view", "c", i) for i in range(2)]
    keys = ("box_psnr", "box_flip")

    def method(label, *figures):
        images = [
            Measured(v, 1.0, dict(zip(keys, f, strict=True))) for v, f in zip(views, figures, strict=True)
        ]
        return MethodResult(label, label, "", {}, images)

    results = Results({}, [method("A", (30, 0.1), (32, 0.2)), method("B", (27, 0.3), (27, None))])
    found = tables.comparison([("Here", results, "novel_view"), ("There", results, "train")], keys, "caption")
    assert (
        found.groups == (("Here", 2), ("There", 2)) and len(found.columns) == 4 and found.caption == "caption"
    )
    a, b, gap = found.rows
    assert [c.text for c in a.cells] == ["31.00", "0.1500", "–", "–"] and [c.best for c in a.cells] == [
        True,
        True,
        False,
        False,
    ]
    assert [c.text for c in b.cells] == ["27.00", "0.3000", "–", "–"] and not any(c.best for c in b.cells)
    assert (
        gap.difference
        and gap.label == "A − B"
        and [c.text for c in gap.cells] == ["+4.00", "−0.1500", "–", "–"]
    )


def test_figures_as_text():
    assert tables.figure("psnr", math.inf) == "∞" and tables.figure("psnr", None) == "–"
    assert tables.signed("psnr", -math.inf) == "−∞" and tables.signed("box_ssim", 0.5) == "+0.5000"
    assert tables.difference(math.inf, math.inf) is None and tables.difference(2.0, None) is None
    times = [tables.duration(s) for s in (None, 0.417, 37.6, 364.8, 7790)]
    assert times == ["–", "0.42 s", "38 s", "6 min 05 s", "2 h 09 min"]
    assert tables.count(1, "image") == "1 image" and tables.count(1200, "step") == "1,200 steps"
    assert tables.named("Mesh, equal time") == "Mesh (equal time)" and tables.named("NDF") == "NDF"
    assert [tables.size(count) for count in (None, 830_400, 2_436_524, 18_459_232, 1_400_000_000)] == [
        "–", "830 kB", "2.4 MB", "18 MB", "1.4 GB"]
