"""``ndf-mi plan``: decides which model a capture needs."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from ndf_mi.capture.capture import Capture
    from ndf_mi.learn.prepare import Planned, Reference
    from ndf_mi.planning.plan import Plan, PlanSettings

_WIDTH = 110


@dataclass
class PlanCapture:
    """Decide from a capture's training images which parts of the model it needs. Prints each finding with its
    evidence."""

    capture: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
    """The capture's folder."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where to write the plan as JSON, for `ndf-mi optimise --model FILE`."""

    accuracy: float = 30.0
    """PSNR in dB within the mask that the model is expected to reach, against which parts are valued."""

    worth: float = 0.1
    """dB of that PSNR that a part must be worth to be kept."""

    frames: int = 24
    """Limit on the training frames read."""

    seed: int = 0
    """Seed of the surface's fit, and for drawing places where there are more than are needed."""

    surface: Literal["offset", "body"] = "offset"
    """The reference surface that the field will be wrapped around: the body with offsets that are fitted to
    the images first, or the body alone."""

    def run(self) -> int:
        """Prints the findings, and writes the plan if requested."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.learn.options import TrainingOptions
        from ndf_mi.learn.prepare import reference
        from ndf_mi.planning.plan import PlanSettings

        settings = PlanSettings(self.accuracy, self.worth, self.frames, self.seed)
        capture = Capture.read(self.capture)
        options = TrainingOptions(seed=self.seed, surface=self.surface)
        with status() as show:
            surface = reference(capture, options, show)
        print(described(surface))
        plan = planned(capture, surface, settings).plan
        print(printed(plan))
        if self.out is not None:
            plan.write(self.out)
            print(f"\nwrote {self.out}; train with: ndf-mi optimise {self.capture} --model {self.out} -o RUN")
        return 0


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Shows what is being done on a terminal."""
    from rich.console import Console

    with Console(file=sys.stderr).status("reading images") as shown:
        yield shown.update


def described(surface: Reference) -> str:
    """The reference surface as text."""
    from ndf_mi.learn.prepare import SLACK, record

    found = record(surface).get("surface")
    if found is None:
        return "reference surface: the capture's body"
    return (f"reference surface: the body with offsets of {found['offset_median_mm']:.0f} mm (median) to "
            f"{found['offset_max_mm']:.0f} mm, made in {found['seconds']:.0f} s; before the offsets were "
            f"shortened by {1e3 * SLACK:.0f} mm, its silhouettes and the masks overlapped by "
            f"{found['agreement']:.2f} (intersection over union)")


def planned(capture: Capture, surface: Reference, settings: PlanSettings) -> Planned:
    """The plan for a capture around a reference surface; a terminal shows the progress."""
    from ndf_mi.learn.prepare import planned as plan

    with status() as show:
        return plan(capture, surface, settings, show)


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
