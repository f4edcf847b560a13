"""Pictures of the points of a front."""

import pytest

from ndf_mi.reports.fronts import groups
from ndf_mi.reports.tradeoff_pictures import front_rows


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
