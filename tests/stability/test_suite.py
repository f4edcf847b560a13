"""What the suite makes of errors: verdicts, the table, files, exit codes."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from ndf_mi import commands
from ndf_mi.errors import InputError
from ndf_mi.stability import report, suite
from ndf_mi.stability.case import LEAST, Case, Measured, error


def case(*rows: Measured, primal: float = 1e-5, gradient: float | None = 1e-5) -> Case:
    return Case("made-up", "tests", "a | b", "1 to 2", primal, gradient, "", lambda: rows)


def test_errors_are_relative_and_infinite_where_not_finite():
    assert error([1.0, 2.0], [1.0, 2.0]) == 0
    assert error([1.1, 2.0], [1.0, 2.0]) == pytest.approx(0.1)
    assert error([1.1, 2.0], [1.0, 2.0], 10.0) == pytest.approx(0.01)
    assert error([0.5 * LEAST], [0.0]) == 0 and error([1e-30], [0.0]) == math.inf
    for broken in (np.nan, np.inf):
        assert error([1.0, broken], [1.0, 1.0]) == math.inf
    with pytest.raises(ValueError, match="shape"):
        error([1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="not finite"):
        error([1.0], [np.nan])


@pytest.mark.parametrize(("rows", "kept"), [
    ([Measured("a", 1e-6, 1e-6), Measured("b", 1e-5, 0.0)], True),
    ([Measured("a", 1e-6, 1e-6), Measured("b", 2e-5, 0.0)], False),
    ([Measured("a", 1e-6, 1e-4)], False),
    ([Measured("a", math.inf, 0.0)], False),
    ([Measured("a", math.nan, 0.0)], False),
    ([Measured("a", 0.0)], False),  # a gradient was promised, and none compared
    ([], False),
])
def test_verdicts(rows, kept):
    result = case(*rows).run()
    assert result.passed is kept
    assert (report.cells(result)[-1] == "kept") is kept


def test_table_and_json(tmp_path):
    results = [case(Measured("1", 1e-7, 0.0)).run(), case(Measured("2", math.inf), gradient=None).run()]
    report.write(tmp_path / "t.md", results, {})
    lines = (tmp_path / "t.md").read_text().splitlines()
    assert len(lines) == 6 and "a \\| b" in lines[2] and "1.0e-07" in lines[2] and "kept" in lines[2]
    assert "not finite" in lines[3] and "BROKEN" in lines[3] and "at 2" in lines[5]
    report.write(tmp_path / "t.json", results, {"variant": "v"})
    read = json.loads((tmp_path / "t.json").read_text())
    assert read["variant"] == "v" and [c["passed"] for c in read["cases"]] == [True, False]
    assert read["cases"][1]["primal"] == "inf" and read["cases"][1]["gradient"] is None
    with pytest.raises(InputError, match=r"\.md or \.json"):
        report.write(tmp_path / "t.csv", results, {})
    assert not (tmp_path / "t.csv").exists()


def test_every_case_has_a_name_a_promise_and_a_subject():
    cases = suite.cases()
    assert {c.subject for c in cases} == set(suite.SUBJECTS)
    assert all(c.primal >= 0 and c.what and c.over for c in cases)
    # What promises other than 1e-5 relative says relative to what.
    assert all(c.relative_to for c in cases if c.primal > 1e-5 or (c.gradient or 0) > 1e-5)


def test_command(tmp_path, monkeypatch, capsys):
    assert commands.main(["stability", "--only", "elementary-functions", "-o", str(tmp_path / "t.json")]) == 0
    assert json.loads((tmp_path / "t.json").read_text())["cases"][0]["passed"] is True
    assert "1 cases, 0 broken" in capsys.readouterr().out
    monkeypatch.setattr(suite, "cases", lambda names: [case(Measured("here", 1.0, 0.0))])
    assert commands.main(["stability", "-o", str(tmp_path / "t.md")]) == 1
    assert "made-up: at here" in capsys.readouterr().out and "BROKEN" in (tmp_path / "t.md").read_text()


def test_a_case_that_raises_is_broken_and_the_others_go_on(tmp_path, monkeypatch, capsys):
    def raises():
        yield Measured("first", 1e-7)
        raise RuntimeError("no kernel")

    bad = Case("bad", "tests", "a", "1", 1e-5, None, "", raises)
    monkeypatch.setattr(suite, "cases", lambda names: [bad, case(Measured("here", 1e-7, 0.0))])
    assert commands.main(["stability", "-o", str(tmp_path / "t.json")]) == 1
    out = capsys.readouterr().out
    assert "bad: at raised RuntimeError('no kernel'): primal not finite" in out and "2 cases, 1 broken: bad" in out
    first, second = json.loads((tmp_path / "t.json").read_text())["cases"]
    assert [row["at"] for row in first["measured"]] == ["first", "raised RuntimeError('no kernel')"] and first["primal"] == "inf"
    assert second["passed"] is True
    with pytest.raises(RuntimeError, match="no kernel"):
        bad.run()


def test_rows_are_printed_as_they_come(monkeypatch, capsys):
    seen = []

    def late():
        seen.append(capsys.readouterr().out)
        yield Measured("here", 0.0)

    cases = [case(Measured("here", 1e-7, 0.0)), Case("late", "tests", "a", "1", 1e-5, None, "", late)]
    monkeypatch.setattr(suite, "cases", lambda names: cases)
    assert commands.main(["stability"]) == 0
    assert "made-up" in seen[0] and "kept" in seen[0] and "late" not in seen[0]


@pytest.mark.parametrize("arguments", [["--only", "no-such"], ["-o", "table.csv"]])
def test_mistakes_are_named(arguments, capsys):
    assert commands.main(["stability", *arguments]) == 2
    assert arguments[1] in capsys.readouterr().err


def test_what_is_quick_and_named_must_leave_something_to_try(capsys):
    long = next(one.name for one in suite.cases() if one.long)
    assert commands.main(["stability", "--quick", "--only", long]) == 2
    assert long in capsys.readouterr().err
