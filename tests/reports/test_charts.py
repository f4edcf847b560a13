"""Charts: SVG that scales, in the page's colours, described by its figures."""

import math
import re
from xml.etree import ElementTree

import pytest

from ndf_mi.reports import charts

POINTS = [("quick", 0.1, 20.0), ("beaten", 0.3, 19.0), ("middle", 0.4, 25.0), ("best", 1.0, 26.0)]


MEASURED = ("measured", [1e3, 2e3, 1e4], [0.1, 0.2, 1.0])
FIT = ("∝ x^1.00", [1e3, 1e4], [0.1, 1.0])


@pytest.fixture(params=["line", "front", "fit"])
def chart(request):
    if request.param == "line":
        series = [("NDF", [1.0, 2.0, 3.0], [20.0, math.nan, 31.5])]
        return charts.line_chart(
            series, "frame", "dB", "Title", ("still", [1, 2, 3], [9.0, 9.0, 9.0]), log_x=True
        )
    if request.param == "front":
        return charts.front_chart(POINTS, [0, 2, 3], 2, "seconds", "dB", "Title", ("converged", 27.0))
    return charts.fit_chart(MEASURED, FIT, "rays", "s", "Title")


def test_a_chart_scales_and_takes_the_page_s_colour(chart):
    root = ElementTree.fromstring(chart.svg)
    assert root.tag.endswith("svg") and "viewBox" in root.attrib
    assert not {"width", "height"} & set(root.attrib)
    assert "currentColor" in chart.svg and charts.INK not in chart.svg and "<metadata" not in chart.svg
    assert chart.title == "Title"


def test_identifiers_are_unique_and_the_same_from_run_to_run():
    first, again, other = (
        charts.line_chart([("a", [1, 2], [3, 4])], "x", "y", title) for title in ("A", "A", "B")
    )
    assert first == again
    identifiers = [set(re.findall(r'\bid="([^"]+)"', chart.svg)) for chart in (first, other)]
    assert identifiers[0] and not identifiers[0] & identifiers[1]
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', first.svg)) <= identifiers[0]


def test_lines_are_described():
    series = [("NDF", [1, 2, 3], [20.0, math.nan, 31.5]), ("Mesh", [1], [math.nan]), ("Point", [2], [7.0])]
    alt = charts.line_chart(series, "frame", "dB", "").alt
    for text in ("frame", "dB", "NDF: from 20 at 1 to 31.5 at 3", "Mesh: no finite value", "Point: 7 at 2."):
        assert text in alt


def test_a_front_is_described_and_named():
    chart = charts.front_chart(POINTS, [0, 2, 3], 2, "seconds", "dB", "", ("converged", 27.0))
    assert (
        "4 points" in chart.alt
        and "middle: 0.4, 25.00 (knee)" in chart.alt
        and "converged, 27.00" in chart.alt
    )
    assert all(f">{label}<" in chart.svg for label in ("quick", "middle", "best"))
    assert ">beaten<" not in chart.svg
    assert [key.label for key in chart.legend] == ["Pareto front", "dominated", "knee", "converged"]
    assert chart.legend[-1].colour == "currentColor"


def test_any_number_of_lines_can_be_told_apart():
    chart = charts.line_chart([(f"method {i}", [1, 2], [i, i]) for i in range(9)], "x", "y", "")
    assert len({(key.colour, key.shape) for key in chart.legend}) == 9
    assert not charts.line_chart([("alone", [1, 2], [3, 4])], "x", "y", "").legend


def test_measurements_are_described_with_their_fit():
    alt = charts.fit_chart(MEASURED, FIT, "rays", "s", "").alt
    assert FIT[0] in alt and "1 at 10,000" in alt
    # A level cost does not fill the height with its noise.
    charts.fit_chart(("measured", [1, 2, 3], [1.0, 1.01, 0.99]), ("about 1", [1, 3], [1, 1]), "rays", "s", "")
