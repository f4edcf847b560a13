"""What the stability suite is made of: errors, tolerances, the table, and the comparison of projections."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import drjit as dr
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.projection import PosedSurface
from ndf_mi.stability import table
from ndf_mi.stability.case import LEAST, Case, Check, Point, error
from ndf_mi.stability.projections import Shape, judge
from ndf_mi.stability.table import Result, Table
from ndf_mi.stability.test_geometry import box, turned_ball

CASE = Case("a | b", "1 to 2")
WITHOUT = dataclasses.replace(CASE, gradient=None)


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


@pytest.mark.parametrize(("case", "errors", "passes"), [
    (CASE, (1e-5, 1e-5), True),
    (CASE, (2e-5, 0.0), False),
    (CASE, (1e-6, 1e-4), False),
    (CASE, (1e-6, None), True),
    (CASE, (math.inf, 0.0), False),
    (CASE, (math.nan, 0.0), False),
    (CASE, (0.0, math.nan), False),
    (CASE, (0.0,), False),  # it tolerates an error of the gradient, and none was measured
    (WITHOUT, (1e-6,), True),
    (WITHOUT, (1e-6, 0.0), False),
])
def test_checks(case, errors, passes):
    recorded = []
    check = Check(case, lambda name, value: recorded.append(value), "here")
    if passes:
        check(*errors)
        assert recorded[0]["at"] == "here" and recorded[0]["primal"] == errors[0]
    else:
        with pytest.raises(AssertionError):
            check(*errors)


def result(*points: Point, case: Case = CASE) -> Result:
    return Result("made-up", "tests", case, False, points=list(points))


@pytest.mark.parametrize(("points", "within"), [
    ([Point("a", 1e-6, 1e-6), Point("b", 1e-5, 0.0)], True),
    ([Point("a", 1e-6, 1e-6), Point("b", 2e-5, 0.0)], False),
    ([Point("a", 0.0)], False),  # no gradient was compared
    ([], False),
])
def test_verdicts(points, within):
    assert result(*points).within is within
    assert (result(*points).cells()[-1] == "within") is within


def test_table_and_json(tmp_path):
    results = [result(Point("1", 1e-7, 0.0)), result(Point("2", math.inf), case=WITHOUT)]
    table.write(tmp_path / "t.md", results, {})
    lines = (tmp_path / "t.md").read_text().splitlines()
    assert len(lines) == 6 and "a \\| b" in lines[2] and "1.0e-07" in lines[2] and "within" in lines[2]
    assert "not finite" in lines[3] and "EXCEEDS" in lines[3] and "at 2" in lines[5]
    table.write(tmp_path / "t.json", results, {"variant": "v"})
    read = json.loads((tmp_path / "t.json").read_text())
    assert read["variant"] == "v" and [c["within"] for c in read["cases"]] == [True, False]
    assert read["cases"][1]["primal"] == "inf" and read["cases"][1]["gradient"] is None
    with pytest.raises(InputError, match=r"\.md or \.json"):
        table.write(tmp_path / "t.csv", results, {})
    assert not (tmp_path / "t.csv").exists()


SUITE = """
import pytest
from ndf_mi.stability.case import case

HERE = case("a", "1 to 2", gradient=None)

@HERE
@pytest.mark.parametrize("error", [1e-7, 1.0])
def test_here(check, error):
    check(error)

@HERE
def test_more_of_it(check):
    check(0.0, at="there")

@case("b", "1", gradient=None)
def test_raises(check):
    check(0.0)
    raise RuntimeError("no kernel")

@pytest.mark.long
@case("c", "1", gradient=None)
def test_long(check):
    check(0.0)

def test_without_a_case():
    raise AssertionError
"""


def run(folder: Path, **options) -> Table:
    """The table of the suite above."""
    # Another folder each time, as modules of one name are imported once.
    folder /= f"suite{len(list(folder.iterdir()))}"
    folder.mkdir()
    (folder / "test_made_up.py").write_text(SUITE)
    (folder / "conftest.py").write_text("from ndf_mi.stability.conftest import check, pytest_configure")
    found = Table(**options)
    pytest.main(
        [
            "-c", "/dev/null", f"--rootdir={folder.parent}", "--import-mode=importlib", "-p", "no:terminal",
            "-p", "no:cacheprovider", str(folder)],
        plugins=[found],
    )
    return found


def test_the_table_has_a_row_for_each_case_as_soon_as_it_is_done(tmp_path):
    reported = []
    here, raises, long = run(tmp_path, report=lambda result: reported.append(result.name)).results.values()
    assert reported == [here.name, raises.name, long.name] == ["here", "raises", "long"]
    assert (
        [point.at for point in here.points] == ["1e-07", "1.0", "there"] and not here.within
        and len(here.details()) == 1)
    assert "no kernel" in raises.failures[0].at and raises.primal == math.inf
    assert long.within and long.long and long.subject == "made-up"


def test_cases_are_selected_by_name_subject_and_length(tmp_path):
    assert [r.name for r in run(tmp_path, only=["long"]).results.values()] == ["long"]
    assert [r.name for r in run(tmp_path, only=["made-up"], quick=True).results.values()] == [
        "here", "raises"]
    unknown = run(tmp_path, only=["here", "nowhere"])
    assert unknown.unknown == ["nowhere"] and not any(r.points for r in unknown.results.values())


RNG = np.random.default_rng(0)


def places(kind: str) -> tuple[Shape, np.ndarray]:
    """A shape, and points on its faces, just off them, on its corners, or just off these."""
    if kind.startswith("face"):
        off = 1e-7 if kind == "face, off" else 0.0
        return box((2, 2, 1), (0, 0, -0.5)), np.concatenate(
            [RNG.uniform(-0.9, 0.9, (20, 2)), np.full((20, 1), off)], 1)
    shape = turned_ball()
    return shape, shape.vertices * (1 + 3e-6 if kind == "corner, off" else 1)


@pytest.mark.parametrize("kind", ["face", "face, off", "corner", "corner, off"])
def test_wrong_gradients_of_the_distance_are_noticed(kind):
    shape, at = places(kind)
    sign = np.zeros(len(at), int)
    assert judge(shape, at, 0.2, sign, smooth=False)[1] <= 1e-5
    for factor in (1e-6, -1.0):

        def wrong(posed: PosedSurface, x, factor=factor):
            found = posed.project(x)
            found.l = dr.replace_grad(dr.detach(found.l), factor * found.l)
            return found

        assert judge(shape, at, 0.2, sign, smooth=False, project=wrong)[1] > 1e-5


def test_uvs_of_another_chart_are_noticed():
    def wrong(posed: PosedSurface, x):
        found = posed.project(x)
        found.uv = found.uv + 0.01
        return found

    shape, at = places("corner")
    assert judge(shape, at, 0.2, np.zeros(len(at), int), smooth=False, project=wrong)[0] > 1e-3
