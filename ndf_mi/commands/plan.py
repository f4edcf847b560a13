"""``ndf-mi plan``: says which model a capture needs, and why."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass
class PlanCapture:
    """Look at a capture's training images and say which model they need: each finding with its evidence, what follows, what is left out."""

    capture: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
    """The capture's folder."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where to write the plan as JSON; `ndf-mi optimise --model FILE` takes it."""

    accuracy: float = 30.0
    """dB within the mask that the model is expected to reach; what a part is worth is told against an error of this."""

    worth: float = 0.1
    """dB that a part must be worth of that to be kept."""

    frames: int = 24
    """Training frames looked at, at most."""

    seed: int = 0
    """Of the places drawn where there are more than are needed."""

    def run(self) -> int:
        """Prints the findings, and writes the plan if asked to."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.commands.plan_console import planned, printed
        from ndf_mi.planning.plan import Settings

        plan = planned(Capture.read(self.capture), Settings(self.accuracy, self.worth, self.frames, self.seed))
        print(printed(plan))
        if self.out is not None:
            plan.write(self.out)
            print(f"\n{self.out}: written; train with: ndf-mi optimise {self.capture} --model {self.out} -o RUN")
        return 0
