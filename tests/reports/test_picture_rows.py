"""Rows of pictures of a comparison."""

from ndf_mi.experiments.records import View
from ndf_mi.reports.picture_rows import picture_rows, spread


def test_every_method_stands_in_every_row(results, truth, tmp_path):
    rows = picture_rows(results, truth, tmp_path)
    assert {split: len(found) for split, found in rows.splits.items()} == {
        "Novel views": 2,
        "Novel poses": 1,
        "Training views": 1,
    }
    for row in (row for found in rows.splits.values() for row in found):
        labels = [picture.label for panel in row.panels for picture in panel]
        shown = ["Truth", *(method.label for method in results.methods)]
        assert sorted(labels) == sorted([*shown, *(f"Error: {label}" for label in shown[1:])])
    # Errors are at most 0.1, and what rounding to 8 bits adds.
    assert rows.top == 0.2


def test_views_are_spread_over_those_that_all_methods_have(results):
    assert spread(results, "novel_view", 4) == [View("novel_view", "side", 1), View("novel_view", "side", 2)]
    assert spread(results, "novel_pose", 4) == [View("novel_pose", "side", 3)], (
        "an image of a sequence alone is not sampled"
    )
    first, second = results.methods[1].images[:2]
    results.methods[1].images.remove(first)
    assert spread(results, "novel_view", 4) == spread(results, "novel_view", 2, inner=True) == [second.view]
    assert spread(results, "sequence", 4) == []
