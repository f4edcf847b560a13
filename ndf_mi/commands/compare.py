"""``ndf-mi compare``: a run beside textured meshes, on held-out views and poses."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass
class Compare:
    """Compare a trained field with textured meshes that are trained on the same images; write report.html.

    One mesh is the posed body with a texture; the other one has its vertices optimised, too. Each is trained until its
    loss stops falling and, where that takes longer than the field's training did, once more for the same time. What an
    earlier call has trained or measured with the same settings is kept.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of the run."""

    capture: Path
    """Folder of the capture that the run was trained on."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the report, figures and pictures; RUN by default."""

    mesh_seconds: float | None = None
    """Seconds of training for the meshes of equal time; the run's own training time by default."""

    protocol: Literal["ours", "zju", "dynacap"] = "ours"
    """Which images are measured, what the capture must hold and which figures lead; docs/protocols.md describes each."""

    max_images: int | None = None
    """Images measured of the novel views, and of the novel poses; 48 by default, under `zju` and `dynacap` all."""

    sequence: int = 12
    """Successive frames of each split, in one camera, that temporal consistency is measured on; 0 leaves it out."""

    texture: int = 512
    """Texels a side of the meshes' textures."""

    samples: int = 128
    """Candidate samples a ray of the field."""

    seed: int = 0
    """Of the choice of images and of the meshes' training."""

    offsets: Literal["all", "equal-time", "none"] = "all"
    """The mesh with optimised vertices: trained like the other one, only for the equal time, or left out."""

    def run(self) -> None:
        """Compares, prints the table and says where the report is."""
        from ndf_mi.commands.compare_console import ConsoleWatcher, print_tables
        from ndf_mi.experiments.compare import REPORT, Comparison, Settings
        from ndf_mi.reports.compare import command_line

        folder = self.out or self.run_folder
        settings = Settings(
            self.mesh_seconds,
            self.max_images,
            self.texture,
            self.samples,
            self.seed,
            self.protocol,
            self.sequence,
            self.offsets,
        )
        comparison = Comparison(self.run_folder, self.capture, folder, settings, command_line(self._arguments()))
        with ConsoleWatcher(sys.stderr) as watcher:
            results = comparison.run(watcher)
        print_tables(results)
        print(f"\n{folder / REPORT}")

    def _arguments(self) -> list[str]:
        """The options that repeat this call; those at their defaults are left out."""
        arguments = ["compare", str(self.run_folder), "--capture", str(self.capture)]
        for name, field in type(self).__dataclass_fields__.items():
            value = getattr(self, name)
            if name not in ("run_folder", "capture") and value != field.default:
                arguments += [f"--{name.replace('_', '-')}", str(value)]
        return arguments
