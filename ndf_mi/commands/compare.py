"""``ndf-mi compare``: a run, or methods trained here, compared on held-out views and poses."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from ndf_mi.commands.command_line import command_line
from ndf_mi.deprecated import DeprecatedOption
from ndf_mi.errors import InputError

REPORT, CAPTURE, CONFIG = "report.html", "capture.json", "config.json"
_METHODS_HELP = (
    "What is compared, separated by commas; differences refer to the first. `ndf` is the run, `mesh` a "
    "textured mesh, `offset-mesh` one whose vertices are trained too, `gaussians`, `neural-body` and "
    "`animatable-nerf` are other systems, `ndf:FOLDER` is another run, and `images:FOLDER` pictures that "
    "another program rendered, as FOLDER/CAMERA/FRAME.png. `@equal-time` or `@converged` after a name sets "
    "how long it is trained."
)


@dataclass
class Compare:
    """Compare a trained field with other methods on one capture, or train all of them; write report.html.

    Methods without a folder are trained on the same images: for `--seconds`; without that, to convergence
    and, unless that was faster than the run's training, for the same time as the run. What an earlier call
    trained or measured with the same settings is kept, and a training that was stopped continues.
    """

    deprecated: ClassVar[tuple[DeprecatedOption, ...]] = (
        DeprecatedOption("--protocol", "--protocol", {"ours": ("--protocol", "default")}),
        DeprecatedOption(
            "--offsets",
            "--methods",
            {
                "all": (), "equal-time": ("--methods", "ndf,mesh,offset-mesh@equal-time"),
                "none": ("--methods", "ndf,mesh"),
            },
        ),
        DeprecatedOption("--mesh-seconds", "--seconds"),
    )

    target: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN|CAPTURE")]
    """Folder of the run; or of a capture, on which `ndf` is trained as the others are."""

    capture: Path | None = None
    """Folder of the capture that the run was trained on."""

    methods: Annotated[str, tyro.conf.arg(help=_METHODS_HELP)] = "ndf,mesh,offset-mesh"

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the report, figures, pictures and trained methods; RUN by default, needed with a capture."""

    seconds: float | None = None
    """Training time in seconds of each method that is trained here; by default the run's own."""

    seeds: int = 1
    """Trainings of each method that is trained here, with different seeds; tables show means and standard
    deviations."""

    protocol: Literal["default", "zju", "dynacap"] = "default"
    """Which images are measured, what the capture must hold and which metrics lead; see docs/protocols.md."""

    max_images: int | None = None
    """Images measured of each held-out split; 48 by default, all with `zju` and `dynacap`."""

    sequence: int = 12
    """Successive frames that temporal consistency is measured on, in one camera; 0 leaves it out."""

    texture: int = 512
    """Width and height of the meshes' textures in texels."""

    samples: int = 128
    """Candidate samples a ray of the field."""

    seed: int = 0
    """Seed of the choice of images and of trainings."""

    def run(self) -> None:
        """Compares, writes the report, prints the tables and the report's path."""
        from ndf_mi.commands.progress import ConsoleProgress
        from ndf_mi.experiments.compare import Comparison, Settings
        from ndf_mi.reports.compare import headline, notes, write_report
        from ndf_mi.reports.tables import print_table

        run, capture, folder = self._folders()
        settings = Settings(
            self.max_images, self.sequence, self.samples, self.seed, self.protocol,
            tuple(self.methods.split(",")), self.seconds, self.texture, self.seeds,
        )
        comparison = Comparison(run, capture, folder, settings, command_line("compare", self))
        with ConsoleProgress(sys.stderr) as progress:
            results = comparison.run(progress)
        write_report(folder / REPORT, results, comparison.capture, comparison.pictures)
        print_table(headline(results, results.splits()), notes(results))
        print(f"\n{folder / REPORT}")

    def _folders(self) -> tuple[Path | None, Path, Path]:
        """Those of the run, if there is one, of the capture, and for the output."""
        if (self.target / CAPTURE).is_file():
            if self.capture is not None:
                raise InputError("--capture", f"{self.capture}, where {self.target} is a capture as well",
                                 "one of them")
            if self.out is None or self.out.resolve().is_relative_to(self.target.resolve()):
                raise InputError("-o", str(self.out or "none"),
                                 "a folder for the report and the trained methods, outside the capture")
            return None, self.target, self.out
        if not (self.target / CONFIG).is_file():
            raise InputError(self.target, f"neither {CONFIG} nor {CAPTURE}",
                             "the folder of a run or of a capture")
        if self.capture is None:
            raise InputError("--capture", "none", f"the capture that {self.target} was trained on")
        return self.target, self.capture, self.out or self.target
