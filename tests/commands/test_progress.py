"""Progress as lines in a log."""

from __future__ import annotations

import io

from ndf_mi.commands.progress import ConsoleProgress
from ndf_mi.experiments.core import Unit
from ndf_mi.experiments.records import Trained
from ndf_mi.experiments.store import NO_RECORD


def test_a_log_has_one_line_for_each_label():
    units = [Unit(str(i), {}, Trained, Trained, (), label, group) for i, (label, group) in enumerate([
        ("train a", ""), ("render a", ""), ("render a", ""), ("render b", "points"), ("render c", "points")])]
    counts = [(1, 1), (1, 2), (2, 2), (1, 2), (2, 2)]
    stream = io.StringIO()
    with ConsoleProgress(stream) as progress:
        for unit, (number, of) in zip(units, counts, strict=True):
            progress.begin(unit, number, of, "capture changed" if unit.label == "render b" else NO_RECORD)
            progress.training(unit.label, 1.0, None, 1, 0.01)
            progress.done(unit, number, of)
    lines = ["train a", "render a (1 of 2)", "render b (1 of 2; capture changed)", "render c (2 of 2)"]
    assert stream.getvalue().splitlines() == lines
