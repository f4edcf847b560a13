"""``ndf-mi compare``: a run compared with other methods, on held-out views and poses."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from ndf_mi.commands.command_line import command_line
from ndf_mi.deprecated import DeprecatedOption

REPORT = "report.html"
_METHODS_HELP = (
    "What is compared, separated by commas; differences refer to the first. `ndf` is the run, `mesh` a "
    "textured mesh, `offset-mesh` one whose vertices are trained too, `ndf:FOLDER` another run, and "
    "`images:FOLDER` pictures that another program rendered, as FOLDER/CAMERA/FRAME.png. `@equal-time` or "
    "`@converged` after a name sets how long it is trained."
)


@dataclass
class Compare:
    """Compare a trained field with other methods on one capture; write report.html.

    Methods without a folder are trained on the same images as the run: to convergence and, unless that was
    faster than the run's training, for the same time as the run. What an earlier call trained or measured
    with the same settings is kept.
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
    )

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of the run."""

    capture: Path
    """Folder of the capture that the run was trained on."""

    methods: Annotated[str, tyro.conf.arg(help=_METHODS_HELP)] = "ndf,mesh,offset-mesh"

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the report, figures and pictures; RUN by default."""

    mesh_seconds: float | None = None
    """Training time in seconds for methods of equal time; the run's own training time by default."""

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

        folder = self.out or self.run_folder
        settings = Settings(
            self.max_images, self.sequence, self.samples, self.seed, self.protocol,
            tuple(self.methods.split(",")), self.mesh_seconds, self.texture,
        )
        comparison = Comparison(
            self.run_folder, self.capture, folder, settings, command_line("compare", self)
        )
        with ConsoleProgress(sys.stderr) as progress:
            results = comparison.run(progress)
        write_report(folder / REPORT, results, comparison.capture, comparison.pictures)
        print_table(headline(results, results.splits()), notes(results))
        print(f"\n{folder / REPORT}")
