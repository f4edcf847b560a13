"""Plans on the console."""

from __future__ import annotations

import sys
import textwrap

from rich.console import Console

from ndf_mi.capture.capture import Capture
from ndf_mi.planning.plan import Plan, PlanSettings
from ndf_mi.planning.planner import STEPS, plan

_WIDTH = 110


def planned(capture: Capture, settings: PlanSettings) -> Plan:
    """The plan for a capture; a terminal shows the progress."""
    with Console(file=sys.stderr).status("reading images") as status:
        return plan(capture, settings,
                    lambda step: status.update(f"analysing {step} ({STEPS.index(step) + 1} of {len(STEPS)})"))


def printed(plan: Plan) -> str:
    """The plan as text, finding by finding."""
    cameras, frames = plan.looked_at["cameras"], plan.looked_at["frames"]
    lines = [f"{plan.capture['name']}: {len(frames)} frames of {len(cameras)} training cameras"]
    for finding in plan.findings:
        lines += ["", f"{finding.key}: {finding.question}"]
        rows = (("found", finding.evidence), ("model", finding.follows),
                ("left out", finding.left_out or "nothing"))
        for label, text in rows:
            lines += textwrap.wrap(text, _WIDTH, initial_indent=f"  {label:<10}", subsequent_indent=" " * 12)
    return "\n".join(lines)
