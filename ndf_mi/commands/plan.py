"""``ndf-mi plan``: decides which model a capture needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


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
    """Seed for drawing places where there are more than are needed."""

    def run(self) -> int:
        """Prints the findings, and writes the plan if requested."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.commands.plan_console import planned, printed
        from ndf_mi.planning.plan import PlanSettings

        plan = planned(Capture.read(self.capture),
                       PlanSettings(self.accuracy, self.worth, self.frames, self.seed))
        print(printed(plan))
        if self.out is not None:
            plan.write(self.out)
            print(f"\nwrote {self.out}; train with: ndf-mi optimise {self.capture} --model {self.out} -o RUN")
        return 0
