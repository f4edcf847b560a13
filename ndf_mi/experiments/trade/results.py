"""What is measured of each point of the trade, and `tradeoff.csv`."""

from __future__ import annotations

import csv
import io
import os
import statistics
from typing import Any

import msgspec
from msgspec import Struct

from ndf_mi import files
from ndf_mi.experiments import metrics
from ndf_mi.experiments.records import View

TRUTH = ("box_psnr", "box_ssim", "box_flip")
"""The metrics against the truth."""


class Figures(Struct):
    """Errors of one point in one view; None where undefined, infinite PSNR where there is no error.

    Attributes:
        view: which view.
        truth: against the capture's image, by the keys `TRUTH`; empty if the picture shows another light than
            the capture.
        converged: box PSNR in dB against the same field rendered to convergence.
        model: box PSNR in dB of that converged picture against the capture's image.
    """

    view: View
    truth: dict[str, float | None]
    converged: float | None
    model: float | None


class Drawn(Struct, tag="drawn", tag_field="kind"):
    """The pictures of one point.

    Attributes:
        figures: errors, one entry a view.
        memory: peak in bytes, as `memory.MEANING` defines it.
        metadata: JSON values: `parameters` of the field; `steps` and `training_seconds` of its training;
            `loading`, the seconds a frame that a path-traced scene takes to load, else None.
    """

    figures: list[Figures]
    memory: int | None
    metadata: dict[str, Any] = {}


class Timing(Struct, tag="timing", tag_field="kind"):
    """One repeat of a timing session: every point was rendered once in each timed view, in random order.

    Attributes:
        machine: label → value, as `ndf_mi.machine.describe` returns it, and `sources`, a digest of the code
            that renders.
        timed: number of timed views.
        points: cache keys of the points, by the points' keys.
        seconds: mean seconds a frame, by the points' keys.
    """

    machine: dict[str, str]
    timed: int
    points: dict[str, str]
    seconds: dict[str, float]


class Row(Struct):
    """Everything that was measured of one point.

    Attributes:
        key, axis, label, field: the point's.
        setting: how it is rendered, JSON values.
        by_paths: whether it is path traced; such pictures show another light and have a front of their own.
        cache_key: identifies field, setting and views; records with another key are stale.
        metadata, memory, figures: as in `Drawn`.
        seconds: seconds a frame, one entry a repeat, means over the timed views.
        session: the timing session, a key of the study's `sessions`; rows of one session were timed in turns.
    """

    key: str
    axis: str
    label: str
    field: str
    setting: dict[str, Any]
    by_paths: bool
    cache_key: str
    metadata: dict[str, Any] = {}
    memory: int | None = None
    figures: list[Figures] = []
    seconds: list[float] = []
    session: str = ""

    @property
    def reference(self) -> str:
        """The folder of the converged pictures that it is compared with: same field, as many rays a pixel."""
        return reference_of(self.field, None if self.by_paths else self.setting["spp"])

    @property
    def frame_seconds(self) -> float | None:
        """The median over the repeats."""
        return statistics.median(self.seconds) if self.seconds else None

    def truth(self, metric: str = "box_psnr") -> float | None:
        """The mean over the views of a metric against the truth; None if there is none."""
        return metrics.average([figures.truth.get(metric) for figures in self.figures])

    def converged(self) -> float | None:
        """The mean over the views of the PSNR against convergence."""
        return metrics.average([figures.converged for figures in self.figures])

    def model(self) -> float | None:
        """The mean over the views of the converged field's PSNR against the truth."""
        return metrics.average([figures.model for figures in self.figures])

    def summary(self) -> dict[str, Any]:
        """JSON values for readers of the study's file: the row and its means."""
        means = {key: self.truth(key) for key in TRUTH}
        means |= {"converged": self.converged(), "model": self.model(), "seconds": self.frame_seconds}
        return {**msgspec.to_builtins(self), "means": means}


def reference_of(field: str, spp: int | None) -> str:
    """The folder of a field's converged pictures with so many rays a pixel; None for path-traced ones."""
    return f"{field}-converged-{'path' if spp is None else spp}"


class Trade(Struct):
    """The whole study: `about` holds what the report says of it."""

    about: dict[str, Any] = {}
    rows: list[Row] = []

    def row(self, key: str) -> Row | None:
        """The row of a point, or None."""
        return next((row for row in self.rows if row.key == key), None)

    def summary(self) -> dict[str, Any]:
        """JSON values for readers of the study's file."""
        return {"points": [row.summary() for row in self.rows]}

    def write_csv(self, path: str | os.PathLike[str]) -> None:
        """Writes one line a point: all settings, then all measurements, means over the views."""
        settings = list(dict.fromkeys(key for row in self.rows for key in row.setting))
        stream = io.StringIO()
        sheet = csv.writer(stream, lineterminator="\n")
        head = ["point", "axis", "label", "field", "integrator", *settings]
        head += ["seconds_a_frame", "seconds_least", "seconds_most", "repeats", "session"]
        head += ["loading_seconds", "training_seconds", "training_steps", "peak_bytes"]
        head += [*TRUTH, "converged_box_psnr", "model_box_psnr"]
        sheet.writerow(head)
        for row in self.rows:
            integrator = "volpath" if row.by_paths else "quadrature"
            cells: list[Any] = [row.key, row.axis, row.label, row.field, integrator]
            cells += [*map(row.setting.get, settings)]
            cells += [row.frame_seconds, min(row.seconds, default=None), max(row.seconds, default=None)]
            cells += [len(row.seconds), row.session]
            cells += map(row.metadata.get, ("loading", "training_seconds", "steps"))
            cells += [row.memory, *map(row.truth, TRUTH), row.converged(), row.model()]
            sheet.writerow(["" if cell is None else cell for cell in cells])
        files.write_text(path, stream.getvalue())
