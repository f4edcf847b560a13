"""A pytest plugin that collects the errors of each case, prints a row for it, and makes tables of all."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pytest

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.stability.case import MARK, PROPERTY, Case, Point

HEADER = ("case", "what", "over", "primal", "gradient", "tolerance", "verdict")
FORMATS = (".md", ".json")


@dataclass
class Result:
    """What the tests of a case measured.

    Attributes:
        name, subject: of its first test and of the module that this is in.
        case: what it computes, and the tolerances.
        long: whether it takes more than a few seconds.
        pending: the tests that have not run.
        points: the errors.
    """

    name: str
    subject: str
    case: Case
    long: bool
    pending: set[str] = field(default_factory=set)
    points: list[Point] = field(default_factory=list)

    @property
    def primal(self) -> float:
        """The largest error of values; infinite where nothing was measured."""
        return max((point.primal for point in self.points), default=math.inf)

    @property
    def gradient(self) -> float | None:
        """The largest error of gradients; None in a case without them."""
        if self.case.gradient is None:
            return None
        return max((point.gradient for point in self.points if point.gradient is not None), default=math.inf)

    @property
    def failures(self) -> list[Point]:
        """The points at which an error exceeds its tolerance."""
        return [point for point in self.points if not point.within(self.case)]

    @property
    def within(self) -> bool:
        """Whether all errors are within their tolerances, and some were measured."""
        return not self.failures and math.isfinite(self.primal) and math.isfinite(self.gradient or 0.0)

    def cells(self) -> tuple[str, ...]:
        """The row, as :data:`HEADER` names it."""
        verdict = "within" if self.within else "EXCEEDS"
        return (
            self.name, self.case.what, self.case.over, number(self.primal), number(self.gradient),
            tolerance(self.case), verdict)

    def details(self) -> list[str]:
        """A sentence for each point at which an error exceeds its tolerance."""
        return [
            f"{self.name}: at {point.at}: primal {number(point.primal)}, gradient {number(point.gradient)}"
            for point in self.failures]


class Table:
    """Runs the cases that are asked for and reports each when the last of its tests has run.

    Args:
        only: names of cases or subjects; all by default.
        quick: leave out long cases.
        report: called with the result of each case.

    Attributes:
        results: by the case, in the order in which they were collected.
        unknown: names in `only` that are neither cases nor subjects.
        names: of all cases and subjects.
    """

    def __init__(
        self, only: Sequence[str] = (), quick: bool = False,
        report: Callable[[Result], None] = lambda result: None) -> None:
        self.results: dict[Case, Result] = {}
        self.unknown: list[str] = []
        self.names: list[str] = []
        self._only, self._quick, self._report = only, quick, report
        self._cases: dict[str, Case] = {}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keeps the tests of the cases that are asked for."""
        for item in items:
            mark = item.get_closest_marker(MARK)
            if mark is None:
                continue
            case = self._cases[item.nodeid] = mark.args[0]
            if case not in self.results:
                assert isinstance(item, pytest.Function)
                name, subject = (
                    text.removeprefix("test_").replace("_", "-")
                    for text in (item.originalname, item.path.stem))
                self.results[case] = Result(name, subject, case, item.get_closest_marker("long") is not None)
            self.results[case].pending.add(item.nodeid)
        self.names = list(
            dict.fromkeys(name for result in self.results.values() for name in (result.subject, result.name)))
        self.unknown = [name for name in self._only if name not in self.names]
        self.results = {
            case: result for case, result in self.results.items() if not (self._quick and result.long)
            and (not self._only or not {result.name, result.subject}.isdisjoint(self._only))}
        items[:] = (
            [] if self.unknown else [item for item in items if self._cases.get(item.nodeid) in self.results])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Takes the errors that a test recorded, or the exception that it raised."""
        result = self.results[self._cases[report.nodeid]]
        recorded: list[Any] = [value for name, value in report.user_properties if name == PROPERTY]
        points = [Point(**value) for value in recorded]
        if report.when == "call":
            result.points += points
        if report.failed and all(point.within(result.case) for point in points):
            crash = getattr(report.longrepr, "reprcrash", None)
            message = (
                crash.message.splitlines()[0] if crash else str(report.longrepr).strip().splitlines()[-1])
            where = report.nodeid.partition("[")[2].rstrip("]")
            gradient = None if result.case.gradient is None else math.inf
            result.points.append(Point(f"{where}: {message}" if where else message, math.inf, gradient))
        if report.when == "teardown":
            result.pending.discard(report.nodeid)
            if not result.pending:
                self._report(result)


def number(value: float | None) -> str:
    """An error as text with two digits; “–” where there is none, “not finite” for infinity and NaN."""
    if value is None:
        return "–"
    if not math.isfinite(value):
        return "not finite"
    return "0" if value == 0 else f"{value:.1e}"


def tolerance(case: Case) -> str:
    """The tolerances in words."""
    def limit(value: float) -> str:
        return f"{value:g}".replace("e-0", "e-")

    text = limit(case.primal)
    if case.gradient is not None and case.gradient != case.primal:
        text += f", gradient {limit(case.gradient)}"
    if not case.relative_to:
        return text
    return f"{text}: {case.relative_to}" if case.primal == 0 else f"{text} relative to {case.relative_to}"


def line(row: Sequence[str]) -> str:
    """A row or :data:`HEADER` for the terminal, without what is computed and over what range."""
    name, _, _, primal, gradient, tolerated, verdict = row
    return f"{name:<28} {primal:>10} {gradient:>10}  {verdict:<7} {tolerated}"


def markdown(results: Sequence[Result]) -> str:
    """The table."""
    rows = [HEADER, ("---",) * len(HEADER), *(result.cells() for result in results)]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    details = [f"- {text}" for result in results for text in result.details()]
    return "\n".join([*lines, *([""] if details else []), *details]) + "\n"


def as_json(results: Sequence[Result], about: dict[str, Any]) -> dict[str, Any]:
    """Everything measured, for programs; errors that are not finite become "inf".

    Args:
        results: the cases.
        about: further entries, such as the variant.
    """
    def value(error: float | None) -> float | str | None:
        return error if error is None or math.isfinite(error) else "inf"

    return {
        "format": "ndf-mi stability",
        "version": 2,
        **about,
        "cases": [
            {
                "name": result.name,
                "subject": result.subject,
                "what": result.case.what,
                "over": result.case.over,
                "tolerance": {
                    name: asdict(result.case)[name] for name in ("primal", "gradient", "relative_to")},
                "primal": value(result.primal),
                "gradient": value(result.gradient),
                "within": result.within,
                "measured": [
                    {"at": point.at, "primal": value(point.primal), "gradient": value(point.gradient)}
                    for point in result.points],
            }
            for result in results
        ],
    }


def check_suffix(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless :func:`write` can write to a file of this name."""
    if Path(path).suffix not in FORMATS:
        raise InputError("-o", os.fspath(path), f"a file name that ends in {' or '.join(FORMATS)}")


def write(path: str | os.PathLike[str], results: Sequence[Result], about: dict[str, Any]) -> None:
    """Writes the table as Markdown or JSON, depending on the suffix.

    Raises:
        InputError: the suffix is neither, or the file cannot be written.
    """
    check_suffix(path)
    if Path(path).suffix == ".md":
        files.write_text(path, markdown(results))
    else:
        files.write_json(path, as_json(results, about))
