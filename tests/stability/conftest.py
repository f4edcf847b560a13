"""Fixtures of the cases: the comparison of errors with tolerances, and a field of known density."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from ndf_mi.stability.ball import Ridge, ridge
from ndf_mi.stability.case import MARK, Check


def pytest_configure(config: pytest.Config) -> None:
    """Describes the marks, so that the suite runs without the project's own configuration."""
    config.addinivalue_line("markers", f"{MARK}(case): errors are compared with the tolerances of a case")
    config.addinivalue_line("markers", "long: takes more than a few seconds")


@pytest.fixture
def check(request: pytest.FixtureRequest, record_property: Callable[[str, object], None]) -> Check:
    """Compares errors with the tolerances of the test's case."""
    parameters = getattr(request.node, "callspec", None)
    return Check(
        request.node.get_closest_marker(MARK).args[0], record_property, parameters.id if parameters else "")


@pytest.fixture(scope="module")
def ball() -> Iterator[Ridge]:
    """The ridge of default size at the origin. Tests that change its weights make one of their own."""
    with ridge() as found:
        yield found
