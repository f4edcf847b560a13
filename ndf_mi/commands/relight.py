"""``ndf-mi relight``: a run shown in another light, compared with a diffuse textured mesh."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from ndf_mi.commands.command_line import command_line
from ndf_mi.deprecated import DeprecatedOption

REPORT = "report.html"


@dataclass
class Relight:
    """Show a field that was trained through scattering in the light of another capture, next to a diffuse
    textured mesh trained on the same images; write report.html. What an earlier call trained or measured with
    the same settings is kept.
    """

    deprecated: ClassVar[tuple[DeprecatedOption, ...]] = (DeprecatedOption("--lattice", "--grid-spacing"),)

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a run made by `ndf-mi optimise --integrator prbvolpath`."""

    capture: Path
    """Folder of the capture that the run was trained on."""

    under: Path
    """Folder of a capture of the same performance in another light."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the report, figures and pictures; RUN/relight by default."""

    spp: int = 256
    """Samples a pixel, an even number."""

    max_images: int | None = None
    """Images measured of each held-out split; 48 by default."""

    texture: int = 256
    """Width and height of the mesh's reflectance texture in texels."""

    grid_spacing: float = 0.0
    """Spacing in metres of a grid that replaces the field: much faster, blurred by a cell; 0 for none."""

    seed: int = 0
    """Seed of the choice of images and of the mesh's training."""

    def run(self) -> None:
        """Relights, writes the report, prints the tables and the report's path."""
        from ndf_mi.commands.progress import ConsoleProgress
        from ndf_mi.experiments.relight import Relighting, Settings
        from ndf_mi.reports.relight import notes, table, write_relight_report
        from ndf_mi.reports.tables import print_table

        folder = self.out or self.run_folder / "relight"
        settings = Settings(self.spp, self.max_images, self.texture, self.grid_spacing, self.seed)
        relighting = Relighting(
            self.run_folder, self.capture, self.under, folder, settings, command_line("relight", self)
        )
        with ConsoleProgress(sys.stderr) as progress:
            relighting.run(progress)
        pictures = {light: relighting.pictures(light) for light in relighting.results}
        write_relight_report(folder / REPORT, relighting.results, relighting.captures, pictures)
        print_table(table(relighting.results), notes(relighting.results))
        print(f"\n{folder / REPORT}")
