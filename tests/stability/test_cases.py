"""Every case of the suite keeps its promise: each compares with float64 what it measures."""

from __future__ import annotations

import pytest

from ndf_mi.stability import suite


@pytest.mark.parametrize("case", [pytest.param(case, marks=pytest.mark.long if case.long else (), id=case.name) for case in suite.cases()])
def test_promise(case):
    result = case.run()
    assert result.passed, [str(row) for row in result.failures] or "nothing was measured"
    # A case that compares gradients has compared some.
    assert (case.gradient is None) == (result.gradient is None)
    assert case.gradient is None or any(row.gradient is not None for row in result.rows)
