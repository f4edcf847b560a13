"""The suite's table: for the terminal, as markdown, and as JSON."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.experiments.metrics import to_json
from ndf_mi.stability.case import Case, Result

HEADER = ("case", "what", "over", "primal", "gradient", "promised", "verdict")
FORMATS = (".md", ".json")


def number(value: float | None) -> str:
    """An error as text: two digits, “–” where there is none, “not finite” for infinity."""
    if value is None:
        return "–"
    if value == float("inf"):
        return "not finite"
    return "0" if value == 0 else f"{value:.1e}"


def promise(case: Case) -> str:
    """What is promised, in words."""
    def limit(value: float) -> str:
        return f"{value:g}".replace("e-0", "e-")

    text = limit(case.primal)
    if case.gradient is not None and case.gradient != case.primal:
        text += f", gradient {limit(case.gradient)}"
    if not case.relative_to:
        return text
    return f"{text}: {case.relative_to}" if case.primal == 0 else f"{text} relative to {case.relative_to}"


def cells(result: Result) -> tuple[str, ...]:
    """The row of a case, as :data:`HEADER` names it."""
    case = result.case
    return (case.name, case.what, case.over, number(result.primal), number(result.gradient), promise(case),
            "kept" if result.passed else "BROKEN")


def line(row: Sequence[str]) -> str:
    """A case's row, or :data:`HEADER`, for the terminal: what it is of and over is in the files."""
    name, _, _, primal, gradient, promised, verdict = row
    return f"{name:<28} {primal:>10} {gradient:>10}  {verdict:<7} {promised}"


def details(result: Result) -> list[str]:
    """A sentence for each point of a case's range at which the promise is broken."""
    return [f"{result.case.name}: at {row.at}: primal {number(row.primal)}, gradient {number(row.gradient)}" for row in result.failures]


def markdown(results: Sequence[Result]) -> str:
    """The table."""
    rows = [HEADER, ("---",) * len(HEADER), *map(cells, results)]
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    broken = [line for result in results for line in details(result)]
    if broken:
        lines += ["", *(f"- {line}" for line in broken)]
    return "\n".join(lines) + "\n"


def as_json(results: Sequence[Result], about: dict[str, Any]) -> dict[str, Any]:
    """Everything measured, for programs; infinite errors are "inf".

    Args:
        about: what else is to be told, such as the variant.
    """
    return {
        "format": "ndf-mi stability", "version": 1, **about,
        "cases": [{
            "name": result.case.name, "subject": result.case.subject, "what": result.case.what, "over": result.case.over,
            "promise": {"primal": result.case.primal, "gradient": result.case.gradient, "relative_to": result.case.relative_to},
            "primal": to_json(result.primal), "gradient": to_json(result.gradient), "passed": result.passed,
            "measured": [{"at": row.at, "primal": to_json(row.primal), "gradient": to_json(row.gradient)} for row in result.rows],
        } for result in results],
    }


def check(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless :func:`write` knows what to write to a path."""
    if Path(path).suffix not in FORMATS:
        raise InputError("-o", os.fspath(path), f"a file's name that ends in {' or '.join(FORMATS)}")


def write(path: str | os.PathLike[str], results: Sequence[Result], about: dict[str, Any]) -> None:
    """Writes the table as markdown or JSON, by the path's suffix; whole or not at all.

    Raises:
        InputError: the suffix is neither.
    """
    check(path)
    if Path(path).suffix == ".md":
        files.write_text(path, markdown(results))
    else:
        files.write_json(path, as_json(results, about))
