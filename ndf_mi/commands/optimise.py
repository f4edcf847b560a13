"""``ndf-mi optimise``: trains a field on a capture."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from ndf_mi.errors import InputError


@dataclass
class Optimise:
    """Train a neural deformable field on a capture's training split. Interrupt it when you like; --resume goes on."""

    capture: Annotated[Path, tyro.conf.Positional]
    """The capture's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The run's folder: new or empty, or with --resume one made before."""

    preset: str = "fast"
    """Architecture: fast, paper or tiny."""

    ablation: str = "full"
    """Take a part of the method away: naked, no-pose, no-projection, no-deform, one-piece, unsigned or surface-point."""

    integrator: str = "ndf_quadrature"
    """ndf_quadrature learns what is seen, with the light in it; prbvolpath learns density and albedo through scattering, under the
    capture's known lighting, after `warm_up` steps by quadrature (see --option)."""

    steps: int | None = None
    """Steps in all; with prbvolpath, `warm_up` and 1,000 more by default."""

    seconds: float | None = None
    """Time to train for; the learning rates' decay follows the clock."""

    seed: int | None = None
    """Of weights, rays and jitter."""

    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Any other entry of the preset or of the training options as NAME=VALUE, e.g. band=0.12 or rays=2048 or
    density_layers=[128,128]; may be given several times."""

    resume: bool = False
    """Go on from the last checkpoint in the run's folder, with the options it was started with."""

    def run(self) -> int:
        """Trains; prints where the run is and how well it fits its training rays."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.learn.loop import resume, start, train
        from ndf_mi.learn.scattering import QUADRATURE

        capture = Capture.read(self.capture)
        if self.resume:
            given = [name for name in ("steps", "seconds", "seed") if getattr(self, name) is not None]
            given += [name for name, default in (("ablation", "full"), ("integrator", QUADRATURE)) if getattr(self, name) != default]
            if given or self.option:
                raise InputError("--resume", f"another option beside it (--{(given or ['option'])[0]})",
                                 "none: a resumed run keeps the options it was started with")
            trainer = resume(self.out, capture)
        else:
            preset, training = self._options()
            trainer = start(self.out, capture, preset, training)
        try:
            train(trainer)
        except KeyboardInterrupt:
            print(f"stopped at step {trainer.progress.step}; go on with: ndf-mi optimise {self.capture} -o {self.out} --resume")
            raise
        now = trainer.progress
        print(f"{self.out}: {now.step} steps in {now.seconds:.0f} s, {now.psnr:.2f} dB on the training rays")
        return 0

    def _options(self) -> tuple[Any, Any]:
        from ndf_mi.field import preset
        from ndf_mi.learn.ablations import ablation
        from ndf_mi.learn.options import TrainingOptions
        from ndf_mi.learn.scattering import QUADRATURE, SCATTERING_STEPS, check_integrator, relightable

        check_integrator(self.integrator)
        if self.seconds is not None and not self.seconds > 0:
            raise InputError("--seconds", f"{self.seconds:g}", "a time above 0")
        training = TrainingOptions.paper() if self.preset == "paper" else TrainingOptions()
        base, training = ablation(self.ablation).apply(preset(self.preset), training)
        if self.integrator != QUADRATURE:
            base, changed = relightable(base)
            training = dataclasses.replace(training, integrator=self.integrator, steps=training.warm_up + SCATTERING_STEPS)
            if changed:
                print(f"{self.integrator}: preset {base.name} with {', '.join(changed)}, so that colours hold no light, paths stay short")
        architecture = {f.name for f in dataclasses.fields(base)} - {"name"}
        schedule = {f.name for f in dataclasses.fields(training)}
        changes: dict[str, Any] = {k: getattr(self, k) for k in ("steps", "seconds", "seed") if getattr(self, k) is not None}
        if self.seconds is not None and self.steps is None:
            changes["steps"] = 10**9
        for text in self.option:
            name, equals, value = text.partition("=")
            name = name.strip().replace("-", "_")
            if not equals or name not in architecture | schedule:
                raise InputError("--option", repr(text), "NAME=VALUE, NAME one of " + ", ".join(sorted(architecture | schedule)))
            current = getattr(base if name in architecture else training, name)
            changes[name] = _value(text, value, current)
        return (dataclasses.replace(base, **{k: v for k, v in changes.items() if k in architecture}),
                dataclasses.replace(training, **{k: v for k, v in changes.items() if k in schedule}))


def _value(text: str, value: str, current: Any) -> Any:
    """Reads VALUE as the type that the option has now."""
    if isinstance(current, str):
        return value
    try:
        found = json.loads(value)
    except ValueError:
        found = None
    if isinstance(current, tuple) and isinstance(found, list) and all(type(v) is int for v in found):
        return tuple(found)
    if isinstance(current, float) and isinstance(found, (int, float)) and not isinstance(found, bool):
        return float(found)
    if isinstance(current, bool):
        if isinstance(found, bool):
            return found
        raise InputError("--option", repr(text), "true or false")
    if isinstance(current, int) and type(found) is int:
        return found
    kind = "a list of whole numbers, as [64,64]" if isinstance(current, tuple) else f"a number such as {current}"
    raise InputError("--option", repr(text), kind)
