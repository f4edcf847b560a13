"""``ndf-mi relight``: a run shown in another light, beside a diffuse textured mesh."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass
class Relight:
    """Show a field that was trained through scattering in the light of another capture, beside a diffuse textured mesh that is trained on
    the same images; write report.html. What an earlier call has trained or measured with the same settings is kept.
    """

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
    """Images measured of the novel views, and of the novel poses; 48 by default."""

    texture: int = 256
    """Texels a side of the mesh's reflectance."""

    lattice: float = 0.0
    """Spacing in metres of a lattice to show the field on, as it was trained: several times as fast as the field itself, which 0 shows, and
    blurred by a cell."""

    seed: int = 0
    """Of the choice of images and of the mesh's training."""

    def run(self) -> None:
        """Relights, prints the table and says where the report is."""
        from ndf_mi.commands.compare_console import ConsoleWatcher
        from ndf_mi.commands.relight_console import print_relighting
        from ndf_mi.experiments.relight import REPORT, Relighting, Settings
        from ndf_mi.reports.compare import command_line
        from ndf_mi.reports.relight import write_relight_report

        folder = self.out or self.run_folder / "relight"
        settings = Settings(self.spp, self.max_images, self.texture, self.lattice, self.seed)
        relighting = Relighting(self.run_folder, self.capture, self.under, folder, settings, command_line(self._arguments()))
        with ConsoleWatcher(sys.stderr) as watcher:
            relighting.run(watcher)
        pictures = {light: relighting.pictures(light) for light in relighting.results}
        write_relight_report(folder / REPORT, relighting.results, relighting.captures, pictures)
        print_relighting(relighting.results)
        print(f"\n{folder / REPORT}")

    def _arguments(self) -> list[str]:
        """The options that repeat this call; those at their defaults are left out."""
        arguments = ["relight", str(self.run_folder), "--capture", str(self.capture), "--under", str(self.under)]
        for name, field in type(self).__dataclass_fields__.items():
            value = getattr(self, name)
            if name not in ("run_folder", "capture", "under") and value != field.default:
                arguments += [f"--{name.replace('_', '-')}", str(value)]
        return arguments
