"""``ndf-mi ablate``: what each part of the method is worth on a capture."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ndf_mi.commands.training_options import ABLATION_NAMES, OPTION_HELP, PRESET_HELP, configured

_ONLY_HELP = f"The variants to train, of {', '.join(ABLATION_NAMES)}; the full model is always among them. All by default."


@dataclass
class Ablate:
    """Train the full model and every ablation of it, measure them on held-out views and poses, write the table and report.html.

    Stop it when you like: the same command goes on where it was, in the middle of a training too.
    """

    capture: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
    """The capture's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for a run a variant, the table and the report."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="VARIANT ...", help=_ONLY_HELP)] = ()

    preset: Annotated[str, tyro.conf.arg(help=f"Architecture of the full model: {PRESET_HELP}.")] = "fast"

    steps: int | None = None
    """Steps of each training."""

    seconds: float | None = None
    """Time for each training, in place of a number of steps."""

    seed: int = 0
    """Of weights, rays and jitter, and of the choice of images."""

    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE", help=OPTION_HELP)] = ()

    protocol: Literal["ours", "zju", "dynacap"] = "ours"
    """Which images are measured, and what the capture must hold; docs/protocols.md describes each."""

    max_images: int | None = None
    """Images measured of the novel views, and of the novel poses; 48 by default, under `zju` and `dynacap` all."""

    sequence: int = 12
    """Successive frames of each split on which temporal consistency is measured; 0 for none."""

    samples: int = 128
    """Candidate samples a ray."""

    def run(self) -> None:
        """Trains and measures what is missing, prints the table and says where the report is."""
        from ndf_mi.experiments.ablate import REPORT, Settings, Study
        from ndf_mi.reports.ablate import markdown
        from ndf_mi.reports.compare import command_line

        preset, options = configured(self.preset, self.option, steps=self.steps, seconds=self.seconds, seed=self.seed)
        settings = Settings(self.max_images, self.sequence, self.samples, self.seed, self.protocol)
        study = Study(self.capture, self.out, self.only or ABLATION_NAMES, preset, options, settings, command_line(self._arguments()))
        terminal = sys.stderr.isatty()

        def measured(title: str, done: int, of: int) -> None:
            if terminal or done == of:
                print(f"\rmeasured {title}: {done} of {of} images", end="\n" if done == of else "", file=sys.stderr, flush=True)

        results = study.run(lambda name, number, of: print(f"{number} of {of}: {name}", file=sys.stderr, flush=True), measured)
        print(markdown(results), end="")
        print(f"\n{self.out / REPORT}")

    def _arguments(self) -> list[str]:
        """The options that repeat this call; those at their defaults are left out."""
        arguments = ["ablate", str(self.capture)]
        for name, field in type(self).__dataclass_fields__.items():
            value = getattr(self, name)
            if name == "option":
                arguments += [word for entry in value for word in ("--option", entry)]
            elif name != "capture" and value != field.default:
                arguments += [f"--{name.replace('_', '-')}", *(value if isinstance(value, tuple) else [str(value)])]
        return arguments
