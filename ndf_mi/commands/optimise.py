"""``ndf-mi optimise``: trains a field on a capture."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ndf_mi.commands.training_options import ABLATION_NAMES, OPTION_HELP, PRESET_HELP, configured
from ndf_mi.errors import InputError
from ndf_mi.run import QUADRATURE

if TYPE_CHECKING:
    from ndf_mi.capture.capture import Capture
    from ndf_mi.field import Preset
    from ndf_mi.learn.options import TrainingOptions
    from ndf_mi.learn.trainer import Trainer


@dataclass
class Optimise:
    """Train a neural deformable field on a capture's training split. Interrupt it at any time; --resume
    continues."""

    capture: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
    """The capture's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The run's folder: new or empty, or an existing run with --resume."""

    model: str | None = None
    """auto, the default: plan the architecture that the capture needs. preset: the fixed preset. Or a plan's
    file, as `ndf-mi plan` writes it."""

    preset: Annotated[str | None, tyro.conf.arg(help=f"A fixed architecture, {PRESET_HELP}; implies --model "
                                                     "preset, whose default is fast.")] = None

    ablation: Annotated[str, tyro.conf.arg(
        help=f"Remove or replace a part of the method: one of {', '.join(ABLATION_NAMES)}.")] = "full"

    integrator: str = "ndf_quadrature"
    """ndf_quadrature: emission and absorption. prbvolpath: scattering under the capture's known light."""

    steps: int | None = None
    """Number of steps. With prbvolpath `warm_up` by quadrature and 1,000 more by default."""

    seconds: float | None = None
    """Training time; the learning rates then decay with the clock."""

    seed: int | None = None
    """Seed of the initial parameters, rays and jitter."""

    refine: Annotated[str | None, tyro.conf.arg(metavar="pose,shape,cameras")] = None
    """Correct the fit together with the field: any of pose (joints, place and turn of the body by frame),
    shape (of the body) and cameras (rotation, place and focal length). With prbvolpath only during
    `warm_up`."""

    camera_colours: bool = False
    """Learn a map of colour for each training camera, for cameras that differ in exposure or white balance.
    With prbvolpath only during `warm_up`."""

    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction,
                      tyro.conf.arg(metavar="NAME=VALUE", help=OPTION_HELP)] = ()

    resume: bool = False
    """Continue from the last checkpoint in the run's folder, with the options that it was started with."""

    def run(self) -> int:
        """Trains; prints where the run is and its error on the training rays."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.learn.loop import train

        capture = Capture.read(self.capture)
        trainer = self._resumed(capture) if self.resume else self._started(capture)
        try:
            train(trainer)
        except KeyboardInterrupt:
            print(f"stopped at step {trainer.progress.step}; continue with: "
                  f"ndf-mi optimise {self.capture} -o {self.out} --resume")
            raise
        now = trainer.progress
        print(f"{self.out}: {now.step} steps in {now.seconds:.0f} s, {now.psnr:.2f} dB on the training rays")
        print(_kept(trainer))
        options = trainer.options
        if options.integrator != QUADRATURE and not trainer.run.scattered:
            print(f"warning: {options.integrator} was not used, because it starts after {options.warm_up} "
                  "steps by quadrature (warm_up); the colours still contain the capture's light. Train again "
                  "with more steps or seconds, or with a smaller warm_up")
        return 0

    def _resumed(self, capture: Capture) -> Trainer:
        from ndf_mi.learn.loop import resume

        kept = ("capture", "out", "resume")
        options = [field for field in dataclasses.fields(self) if field.name not in kept]
        given = [field.name for field in options if getattr(self, field.name) != field.default]
        if given:
            raise InputError("--resume", f"--{given[0]} as well", "no other option",
                             "A resumed run keeps the options that it was started with.")
        return resume(self.out, capture)

    def _started(self, capture: Capture) -> Trainer:
        from ndf_mi.commands.plan import described, planned, printed, status
        from ndf_mi.field import preset as preset_of
        from ndf_mi.learn.loop import expect_new, start
        from ndf_mi.learn.prepare import measured_bands, reference, with_bands
        from ndf_mi.learn.scattering import DENSITY_LIMIT, relightable
        from ndf_mi.options import read_options
        from ndf_mi.planning.plan import PlanSettings, read_preset

        name = self._preset_name()
        training = self._configured(None)[1]
        planning = self._plans(training)
        from_file = None
        if planning and self.model not in (None, "auto"):
            from_file = read_preset(Path(str(self.model)), capture.digest, training.surface)
        expect_new(self.out)
        if self.integrator != QUADRATURE:
            capture.known_lighting()  # Refused here, before the surface's fit takes its time.
        with status() as show:
            surface = reference(capture, training, show)
        print(described(surface))
        base, plan, bands, spent = None, None, None, 0.0
        if from_file:
            base, plan = from_file
            if training.bands == "local":
                settings = read_options(PlanSettings, plan.get("settings", {}), f"{self.model}: settings")
                with status() as show:
                    bands, spent = measured_bands(capture, surface, base, settings, show)
        elif planning:
            settings = PlanSettings()
            if self.integrator != QUADRATURE:
                settings = PlanSettings(density_limit=DENSITY_LIMIT)
            found = planned(capture, surface, settings)
            print(printed(found.plan) + "\n")
            base, plan, spent = found.plan.preset, found.plan.to_dict(), found.seconds
            bands = found.plan.bands
        preset, training = self._configured(base)
        if base is not None:
            surface = with_bands(surface, bands, base, preset, training)
        changed = [] if self.integrator == QUADRATURE else relightable(base or preset_of(name))[1]
        if changed:
            print(f"{self.integrator}: preset {preset.name} with {', '.join(changed)}, so that colours "
                  "contain no light, densities are above 0 and paths stay short")
        return start(self.out, capture, preset, training, plan, surface, spent)

    def _preset_name(self) -> str:
        """The preset's name; raises InputError if a plan is asked for as well."""
        if self.preset is not None and self.model not in (None, "preset"):
            raise InputError("--model", f"--preset {self.preset} as well", "one of the two",
                             "Plans start from the preset fast.")
        return self.preset or "fast"

    def _configured(self, base: Preset | None) -> tuple[Preset, TrainingOptions]:
        return configured(
            self._preset_name(), self.option, ablation_name=self.ablation, steps=self.steps,
            seconds=self.seconds, seed=self.seed, integrator=self.integrator, planned=base,
            refine=None if self.refine is None else tuple(n.strip() for n in self.refine.split(",")),
            camera_colours=self.camera_colours or None)

    def _plans(self, training: TrainingOptions) -> bool:
        """Whether the architecture comes from a plan."""
        if self.model == "preset" or self.preset is not None:
            return False
        if training.atlas == "body":
            return True
        why = "plans choose the grid's resolution for the body's own atlas"
        if self.model is not None:
            raise InputError("--model", f"atlas={training.atlas} as well", "one of the two", f"{why}.")
        print(f"atlas={training.atlas}: the fixed preset {self._preset_name()}, because {why}")
        return False


def _kept(trainer: Trainer) -> str:
    """Which step's field is kept, and why."""
    now, options = trainer.progress, trainer.options
    if now.kept_step is not None:
        best = f"{now.kept_psnr:.2f} dB on held-back training views"
        if now.kept_step == now.step:
            return f"{best}, the best of the training"
        return (f"{best} at step {now.kept_step}, whose field is kept; {now.held_back_psnr:.2f} dB at step "
                f"{now.held_back_step}")
    if now.released:
        return (f"the last step's field is kept: held-back training views were at {now.held_back_psnr:.2f} "
                f"dB at step {now.held_back_step} and not getting worse, and were trained on from there")
    reason = ("held_back=0" if options.held_back == 0 else
              "no views are held back through scattering" if options.integrator != QUADRATURE else
              f"held_back={options.held_back:g} of the training views is less than half a view")
    return f"the last step's field is kept: {reason}"
