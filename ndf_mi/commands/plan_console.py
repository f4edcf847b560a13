"""Plans on the console: made with a line of progress, printed finding by finding."""

from __future__ import annotations

import sys
import textwrap

from rich.console import Console

from ndf_mi.capture.capture import Capture
from ndf_mi.planning.plan import Plan, Settings
from ndf_mi.planning.planner import STAGES, plan

_WIDTH = 118


def planned(capture: Capture, settings: Settings) -> Plan:
    """The plan for a capture; what is being looked at is shown meanwhile, where there is a terminal."""
    with Console(file=sys.stderr).status("looking at images") as status:
        return plan(capture, settings, lambda name: status.update(f"looking at {name} ({STAGES.index(name) + 1} of {len(STAGES)})"))


def printed(plan: Plan) -> str:
    """The plan for people."""
    looked = plan.looked_at
    lines = [f"{plan.capture['name']}: {len(looked['cameras'])} training cameras, {len(looked['frames'])} of their frames"]
    for finding in plan.findings:
        lines += ["", f"{finding.key}: {finding.question}"]
        for label, text in (("found", finding.evidence), ("model", finding.follows), ("left out", finding.left_out or "nothing")):
            lines += textwrap.wrap(text, _WIDTH, initial_indent=f"  {label:<10}", subsequent_indent=" " * 12)
    return "\n".join(lines)
