"""``ndf-mi optimise``: trains a field on a capture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ndf_mi.commands.training_options import ABLATION_NAMES, OPTION_HELP, PRESET_HELP, configured
from ndf_mi.errors import InputError

if TYPE_CHECKING:
    from ndf_mi.capture.capture import Capture
    from ndf_mi.field import Preset


@dataclass
class Optimise:
    """Train a neural deformable field on a capture's training split. Interrupt it when you like; --resume goes on."""

    capture: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
    """The capture's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The run's folder: new or empty, or with --resume one made before."""

    preset: Annotated[str, tyro.conf.arg(help=f"Architecture: {PRESET_HELP}.")] = "fast"

    model: str | None = None
    """`auto`: the architecture that the capture needs, as `ndf-mi plan` finds it; or a plan's file. In the place of --preset."""

    ablation: Annotated[str, tyro.conf.arg(help=f"Take a part of the method away: one of {', '.join(ABLATION_NAMES)}.")] = "full"

    integrator: str = "ndf_quadrature"
    """ndf_quadrature learns what is seen, with the light in it; prbvolpath learns density and albedo through scattering, under the
    capture's known lighting, after `warm_up` steps by quadrature (see --option)."""

    steps: int | None = None
    """Steps in all; with prbvolpath, `warm_up` and 1,000 more by default."""

    seconds: float | None = None
    """Time to train for; the learning rates' decay follows the clock."""

    seed: int | None = None
    """Of weights, rays and jitter."""

    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE", help=OPTION_HELP)] = ()

    resume: bool = False
    """Go on from the last checkpoint in the run's folder, with the options it was started with."""

    def run(self) -> int:
        """Trains; prints where the run is and how well it fits its training rays."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.field import preset as preset_of
        from ndf_mi.learn.loop import resume, start, train
        from ndf_mi.learn.scattering import QUADRATURE, relightable

        capture = Capture.read(self.capture)
        if self.resume:
            given = [name for name in ("steps", "seconds", "seed") if getattr(self, name) is not None]
            defaults = {"ablation": "full", "integrator": QUADRATURE, "model": None, "preset": "fast"}
            given += [name for name, default in defaults.items() if getattr(self, name) != default]
            if given or self.option:
                raise InputError("--resume", f"another option beside it (--{(given or ['option'])[0]})",
                                 "none: a resumed run keeps the options it was started with")
            trainer = resume(self.out, capture)
        else:
            chosen, plan = self._planned(capture)
            preset, training = configured(
                self.preset, self.option, ablation_name=self.ablation, steps=self.steps, seconds=self.seconds, seed=self.seed,
                integrator=self.integrator, planned=chosen)
            if chosen is not None and training.atlas != "body":
                raise InputError("--model", f"atlas={training.atlas} beside it",
                                 "one of the two: a plan's grid is as fine as the body's own atlas needs it")
            base = chosen or preset_of(self.preset)
            changed = [] if self.integrator == QUADRATURE else relightable(base)[1]
            if changed:
                print(f"{self.integrator}: preset {base.name} with {', '.join(changed)}, so that colours hold no light, densities are "
                      "above 0, paths stay short")
            trainer = start(self.out, capture, preset, training, plan)
        try:
            train(trainer)
        except KeyboardInterrupt:
            print(f"stopped at step {trainer.progress.step}; go on with: ndf-mi optimise {self.capture} -o {self.out} --resume")
            raise
        now = trainer.progress
        print(f"{self.out}: {now.step} steps in {now.seconds:.0f} s, {now.psnr:.2f} dB on the training rays")
        options = trainer.options
        if options.integrator != QUADRATURE and not trainer.run.scattered:
            print(f"{options.integrator} has not begun: its turn comes after {options.warm_up} steps by quadrature (warm_up), and the "
                  "colours still hold the light of the capture. Train anew, with more steps or seconds, or a smaller warm_up")
        return 0

    def _planned(self, capture: Capture) -> tuple[Preset | None, dict[str, Any] | None]:
        """The preset of the plan asked for, and the plan's JSON; None where none is."""
        if self.model is None:
            return None, None
        if self.preset != "fast":
            raise InputError("--model", f"--preset {self.preset} beside it", "one of the two: a plan is of the preset fast")
        from ndf_mi.commands.plan_console import planned, printed
        from ndf_mi.planning.plan import Settings, read_preset

        if self.model != "auto":
            return read_preset(Path(self.model), capture.digest)
        plan = planned(capture, Settings())
        print(printed(plan) + "\n")
        return plan.preset, plan.to_dict()
