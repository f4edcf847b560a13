"""Training in a report: times, curves and sentences, from the keys that `methods/base.py` documents."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ndf_mi.experiments.records import HELD_OUT, SPLITS, MethodResult, Results
from ndf_mi.experiments.trade.front import pareto_front
from ndf_mi.reports import charts, tables
from ndf_mi.reports.charts import Chart
from ndf_mi.reports.page import Fact, settings_text
from ndf_mi.reports.tables import Cell, Row, Table


def notes(results: Results) -> list[str]:
    """A sentence or two for each method that has something to say of its training."""
    notes = [note for note in map(_note, results.first().methods) if note]
    if any(len(each.members) > 1 for each in results.trainings()):
        notes.append("Figures with ± are means and standard deviations over trainings that differ by their "
                     "seeds; pictures show the first.")
    return notes


def equal_time_notes(results: Results) -> list[str]:
    """A sentence for each method that was not trained for the equal time because it converged within it."""
    equal = results.about["equal_seconds"]
    keys = {method.key for method in results.methods}
    return [
        f"{method.label}: training converged within the first method’s training time "
        f"({tables.duration(equal)}), so this row is also its result at equal time."
        for method in results.methods
        if method.metadata.get("converged")
        and method.metadata["seconds"] <= equal
        and method.key.replace("converged", "equal-time") not in keys
    ]


def times(results: Results) -> Table:
    """Seconds, steps and peak memory of training, size on disk, and seconds an image."""
    rows = [
        Row(method.label, tuple(map(Cell, (
            tables.duration(method.metadata.get("seconds")),
            "–" if method.metadata.get("steps") is None else f"{method.metadata['steps']:,}",
            tables.size(method.metadata.get("peak_memory")),
            tables.size(method.metadata.get("size_on_disk")),
            tables.duration(method.seconds_an_image()),
        ))))
        for method in results.first().methods
    ]
    columns = ("Training time", "Training steps", "Peak memory in training", "Size on disk",
               "Rendering time per image, median")
    return Table(columns, tuple(rows), corner="Method")


def quality(results: Results) -> list[Chart]:
    """Box PSNR against training time, a chart for each held-out split; methods that no other one beats in
    both are joined. Methods that do not say how long they were trained are left out."""
    found = []
    for split in HELD_OUT:
        known = [(each.label, each.first.metadata.get("seconds"), each.mean(split, "box_psnr"))
                 for each in results.trainings()]
        points = [(label, seconds, psnr) for label, seconds, psnr in known
                  if seconds and psnr is not None and math.isfinite(psnr)]
        if len(points) > 1:
            front = pareto_front([seconds for _, seconds, _ in points], [psnr for *_, psnr in points])
            found.append(charts.front_chart(points, front, None, "seconds of training", "box PSNR (dB)",
                                            f"Quality against training time, {SPLITS[split]}"))
    return found


def curves(results: Results) -> Chart | None:
    """PSNR of the training loss over time, of the methods that kept their curve, and of training views that
    some hold back, with the step that they keep; None where there is no curve."""
    lines: list[charts.Series] = []
    rings = []
    for method in results.methods:
        known: Mapping[str, Any] = method.metadata
        loss = [(time, -10 * math.log10(loss)) for _, time, loss in known.get("history", ()) if loss > 0]
        held_back = [(time, psnr) for _, time, psnr in known.get("held_back", ())]
        for suffix, curve in (("", loss), (", held-back views", held_back)):
            points = [(time, psnr) for time, psnr in curve if time > 0]
            if points:
                seconds, psnr = zip(*points, strict=True)
                lines.append((f"{method.label}{suffix}", seconds, psnr))
        for step, time, value in known.get("held_back", ()):
            if step == known.get("kept_step") and time > 0:
                rings.append((f"{method.label}, kept: step {step:,}", len(lines) - 1, time, value))
    title = "PSNR of the training loss" + (" and of held-back training views" if rings else "")
    return charts.line_chart(lines, "seconds of training", "PSNR (dB)", title, log_x=True,
                             rings=rings) if lines else None


def metadata_fact(method: MethodResult) -> Fact:
    """Everything that a method reports of itself, except its curve and its note."""
    hidden = ("history", "held_back", "note", "capture", "peak_memory", "size_on_disk")  # printed elsewhere
    shown = {key: value for key, value in method.metadata.items() if key not in hidden and value is not None}
    plain = {key: value for key, value in shown.items() if not isinstance(value, (Mapping, list, tuple))}
    nested = {key: value for key, value in shown.items() if isinstance(value, Mapping) and value}
    lines = [settings_text(plain)]
    for key, value in nested.items():
        name = "training loss by learning rate" if key == "sweep" else key.replace("_", " ")
        lines.append(f"{name}: {settings_text(value)}")
    return Fact(method.label, tuple(filter(None, lines)) or ("–",))


def _note(method: MethodResult) -> str:
    known: Mapping[str, Any] = method.metadata
    parts = []
    if "converged" in known and known.get("seconds") is not None:
        end = ""
        if known.get("budget") is None:
            end = ", until its loss stopped falling" if known["converged"] else ", until the limit of steps"
        steps = tables.count(known.get("steps", 0), "step")
        parts.append(f"trained for {tables.duration(known['seconds'])}{end}, {steps}.")
    parts += [known["note"]] if known.get("note") else []
    return f"{method.label}: {' '.join(parts)}" if parts else ""
