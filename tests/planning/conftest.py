"""One plan of the tiny capture for all tests."""

from __future__ import annotations

import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.planning.plan import Plan
from ndf_mi.planning.planner import plan


@pytest.fixture(scope="session")
def planned(capture: Capture) -> Plan:
    return plan(capture)
