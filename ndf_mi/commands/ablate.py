"""``ndf-mi ablate``: what each part of the method is worth on a capture."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from ndf_mi.commands.command_line import command_line
from ndf_mi.commands.training_options import ABLATION_NAMES, OPTION_HELP, PRESET_HELP, configured
from ndf_mi.deprecated import DeprecatedOption

REPORT = "report.html"
_ONLY_HELP = (
    f"The variants to train, of {', '.join(ABLATION_NAMES)}; the full model is always added. All by default."
)


@dataclass
class Ablate:
    """Train the full model and its ablations, measure them on held-out views and poses, write the table and
    report.html.

    You can stop it at any time: the same command continues where it stopped, even within a training.
    """

    deprecated: ClassVar[tuple[DeprecatedOption, ...]] = (
        DeprecatedOption("--protocol", "--protocol", {"ours": ("--protocol", "default")}),
    )

    capture: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
    """The capture's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the table, the report and a run for each variant."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="VARIANT ...", help=_ONLY_HELP)] = ()

    preset: Annotated[str, tyro.conf.arg(help=f"Architecture of the full model: {PRESET_HELP}.")] = "fast"

    steps: int | None = None
    """Steps of each training."""

    seconds: float | None = None
    """Time of each training in seconds, instead of a number of steps."""

    seed: int = 0
    """Seed of weights, rays and jitter, and of the choice of images."""

    option: Annotated[
        tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE", help=OPTION_HELP)
    ] = ()

    protocol: Literal["default", "zju", "dynacap"] = "default"
    """Which images are measured, and what the capture must hold; see docs/protocols.md."""

    max_images: int | None = None
    """Images measured of each held-out split; 48 by default, all with `zju` and `dynacap`."""

    sequence: int = 12
    """Successive frames that temporal consistency is measured on, in one camera; 0 leaves it out."""

    samples: int = 128
    """Candidate samples a ray."""

    def run(self) -> None:
        """Trains and measures what is missing, writes the report, prints the table and the report's path."""
        from ndf_mi.commands.progress import ConsoleProgress
        from ndf_mi.experiments.ablate import AblationStudy
        from ndf_mi.experiments.settings import Evaluation
        from ndf_mi.reports.ablate import markdown, write_ablation_report

        preset, options = configured(
            self.preset, self.option, steps=self.steps, seconds=self.seconds, seed=self.seed
        )
        settings = Evaluation(self.max_images, self.sequence, self.samples, self.seed, self.protocol)
        study = AblationStudy(
            self.capture, self.out, self.only or ABLATION_NAMES, preset, options, settings,
            command_line("ablate", self),
        )
        with ConsoleProgress(sys.stderr, bars=False) as progress:
            results = study.run(progress)
        write_ablation_report(self.out / REPORT, results, study.capture, study.pictures)
        print(markdown(results), end="")
        print(f"\n{self.out / REPORT}")
