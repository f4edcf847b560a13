"""Pareto fronts of a study of speed and accuracy, in groups of points that may be compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ndf_mi.experiments.trade.front import knee, pareto_front
from ndf_mi.experiments.trade.points import RUN
from ndf_mi.experiments.trade.results import Row, Trade
from ndf_mi.render.settings import CONVERGED_SAMPLES
from ndf_mi.reports import charts, tables
from ndf_mi.reports.charts import Chart

#: dB by which a slower point must be better to be on a front: half of the last decimal in tables.
WORTH = 0.005

_TRUTH = (
    "The run itself, rendered with different settings. The dashed line is the same field rendered to "
    "convergence: the gap up to the line is rendering error, the rest is the model’s error."
)
_CONVERGENCE = (
    f"The same pictures compared with the same field rendered with {CONVERGED_SAMPLES:,} samples along the "
    "same rays, each ray to its end. This is rendering error alone."
)
_FIELDS = (
    "Fields that the study trained, each with the same budget, rendered with the usual settings. Compare "
    "them with one another only: the run itself may have been trained for longer."
)
_PATHS = (
    "The field rendered by `volpath`: a different, lit picture with fewer pixels, in one view. Noise counts "
    "as error."
)
_LIT = "The same pictures compared with the capture’s images, under the capture’s light."


@dataclass(frozen=True)
class Group:
    """Rows that may be compared with one another in one quality.

    Attributes:
        title, about: heading and description.
        rows: the rows that have it.
        values: their quality in dB, higher is better.
        front: indices of the rows that no other one dominates, by rising seconds.
        knee: index of one of them, or None.
        by_truth: whether the quality is measured against the truth, not against the converged field.
        reference: (label, dB) of a horizontal line, or None.
    """

    title: str
    about: str
    rows: list[Row]
    values: list[float]
    front: list[int]
    knee: int | None
    by_truth: bool
    reference: tuple[str, float] | None = None

    @property
    def chart(self) -> Chart:
        """Quality against seconds."""
        pairs = zip(self.rows, self.values, strict=True)
        points = [(row.label, row.frame_seconds or 0.0, value) for row, value in pairs]
        quality = f"box PSNR against {'the truth' if self.by_truth else 'convergence'} (dB)"
        names = ("seconds per frame", quality, "")
        return charts.front_chart(points, self.front, self.knee, *names, self.reference)

    @property
    def summary(self) -> str:
        """The front in a sentence or two."""
        first, last = self._point(self.front[0]), self._point(self.front[-1])
        if len(self.front) == 1:
            return f"One of {tables.count(len(self.rows), 'point')} dominates all others: {first}."
        end = "It has no knee." if self.knee is None else f"Its knee is {self._point(self.knee)}."
        count = f"{len(self.front)} of {len(self.rows)} points are on the Pareto front"
        return f"{count}, from {first} to {last}. {end}"

    def _point(self, index: int) -> str:
        row = self.rows[index]
        return f"{row.label} ({tables.duration(row.frame_seconds)}, {self.values[index]:.2f} dB)"


def groups(trade: Trade) -> list[Group]:
    """The groups of a study that have points: by quadrature, of trained fields, and path-traced.

    Points that an earlier call timed take part if machine and versions were the same.
    """
    rows = [row for row in trade.rows if comparable(trade, row)]
    own = [row for row in rows if row.field == RUN and not row.by_paths]
    fields = [row for row in rows if row.field != RUN]
    paths = [row for row in rows if row.field == RUN and row.by_paths]
    usual = trade.row("usual")
    model = None if usual is None else usual.model()
    converged = None if model is None else ("converged", model)
    found = [
        _group("Against the truth", _TRUTH, own, True, converged),
        _group("Against convergence", _CONVERGENCE, own, False),
        _group("Other fields", _FIELDS, fields, True),
        _group("Path tracing", _PATHS, paths, False),
        _group("Path tracing, against the truth", _LIT, paths, True),
    ]
    return [group for group in found if group is not None]


def comparable(trade: Trade, row: Row) -> bool:
    """Whether a row was timed by this call, or by one on the same machine with the same versions."""
    sessions = trade.about["sessions"]
    return bool(sessions.get(row.session, {}).get("machine") == sessions[trade.about["session"]]["machine"])


def _group(
    title: str, about: str, rows: Sequence[Row], by_truth: bool, reference: tuple[str, float] | None = None
) -> Group | None:
    """The group of those rows that have seconds and a finite quality; None where there are none."""
    kept: list[tuple[Row, float, float]] = []
    for row in rows:
        seconds, quality = row.frame_seconds, row.truth() if by_truth else row.converged()
        if seconds is not None and quality is not None and math.isfinite(quality):
            kept.append((row, seconds, quality))
    if not kept:
        return None
    found, costs, values = map(list, zip(*kept, strict=True))
    front = pareto_front(costs, values, WORTH)
    at = knee([costs[i] for i in front], [values[i] for i in front])
    bend = None if at is None else front[at]
    return Group(title, about, found, values, front, bend, by_truth, reference)
