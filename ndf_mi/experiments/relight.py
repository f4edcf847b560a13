"""A run that was trained under one light, shown under it and under another, and compared with a diffuse
textured mesh.
"""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments.core import SILENT, Progress
from ndf_mi.experiments.evaluate import ImageSet, Measurement, held_out_views
from ndf_mi.experiments.fit import fitted
from ndf_mi.experiments.records import Results
from ndf_mi.experiments.settings import at_least, option
from ndf_mi.experiments.store import Store
from ndf_mi.methods.base import Budget, Light, Relightable
from ndf_mi.methods.lit_field import RelightableField
from ndf_mi.methods.lit_mesh import RelightableMesh
from ndf_mi.render.scene import lights

SEEN, UNSEEN = "seen", "unseen"
WORK = "relight"
PICTURES = "pictures"
MESH = "mesh"


@dataclass(frozen=True)
class Settings:
    """How to relight.

    Attributes:
        spp: samples a pixel, an even number.
        max_images: images of each held-out split; None for the default protocol's number.
        texture: texels a side of the mesh's reflectance.
        grid_spacing: spacing in metres of the grid that the field is shown on; 0 shows the field itself.
        seed: seed of the choice of images and of the mesh's training.
    """

    spp: int = 256
    max_images: int | None = None
    texture: int = 256
    grid_spacing: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        at_least(self, max_images=1, texture=1, seed=0)
        if self.spp < 2 or self.spp % 2:
            raise InputError("option spp", repr(self.spp), "an even number from 2 on")
        if not 0 <= self.grid_spacing < math.inf:
            raise InputError(option("grid_spacing"), repr(self.grid_spacing), "a length in metres, or 0")


class Relighting:
    """One such comparison in one folder.

    Args:
        run: folder of a run that was trained through scattering.
        capture: folder of the capture that it was trained on.
        under: folder of a capture of the same performance in another light; nothing is learned from it.
        folder: where `seen.json` and `unseen.json` go; pictures and the mesh go to its subfolder `relight`.
        settings: how to relight.
        command: the command that the report names.

    Raises:
        InputError: run or captures cannot be read, do not belong together or lack what is needed. Nothing has
            been written then.
    """

    def __init__(
        self, run: str | os.PathLike[str], capture: str | os.PathLike[str], under: str | os.PathLike[str],
        folder: str | os.PathLike[str], settings: Settings, command: str,
    ) -> None:
        self.folder = Path(folder)
        self.settings = settings
        self.captures = {SEEN: Capture.read(capture), UNSEEN: Capture.read(under)}
        self._field = RelightableField(settings.grid_spacing)
        self._field.load(run, self.captures[SEEN])
        _expect_same_performance(self.captures[SEEN], self.captures[UNSEEN])
        self._lights = {
            name: Light(name, lights(known.known_lighting())) for name, known in self.captures.items()
        }
        self._images = {
            name: ImageSet(known, held_out_views(known, settings.max_images, settings.seed))
            for name, known in self.captures.items()
        }
        self.results = {
            name: Results({"run": os.fspath(run), **images.about(asdict(settings), command)})
            for name, images in self._images.items()
        }
        self._stores = {}
        for name, results in self.results.items():
            store = self._stores[name] = Store(self.folder / f"{name}.json", f"relighting, {name} light")
            store.about, store.summary = results.about, results.summary

    def pictures(self, lighting: str) -> Path:
        """The folder of the pictures under a light, one folder a method."""
        return self.folder / WORK / PICTURES / lighting

    def run(self, progress: Progress = SILENT) -> dict[str, Results]:
        """Trains the mesh and measures both methods under both lights; files are written after each unit."""
        mesh = fitted(
            RelightableMesh(self.settings.texture), MESH, f"train {RelightableMesh.label}",
            {"texture": self.settings.texture}, self.captures[SEEN], Budget(None, self.settings.seed),
            self.folder / WORK / MESH, self._stores[SEEN], progress,
        )
        methods: tuple[Relightable, ...] = (self._field, mesh)
        for name, images in self._images.items():
            frames = sorted({view.frame for view in images.rendered()})
            self.results[name].methods = []
            for method in methods:
                lit = method.under(self._lights[name], frames, self.settings.spp)
                measurement = Measurement(lit.key, lit.label, lit, images, self.pictures(name))
                self.results[name].methods.append(measurement.run(self._stores[name], progress))
            self._stores[name].write()
        return self.results


def _expect_same_performance(capture: Capture, other: Capture) -> None:
    """Raises InputError unless all frames of `other` show the body and poses of `capture`."""
    if not np.array_equal(capture.body.faces, other.body.faces):
        raise InputError(other.path / "body.npz", "another body", f"that of {capture.path}")
    expected = f"the same performance as {capture.path}, in another light"
    for frame, vertices in zip(other.poses.frames, other.poses.vertices, strict=True):
        if frame not in capture.poses.frames:
            raise InputError(other.path / "poses.npz", f"frame {frame}, which that one lacks", expected)
        if not np.allclose(vertices, capture.poses.vertices[capture.poses.index(frame)], atol=1e-5):
            raise InputError(other.path / "poses.npz", f"another pose in frame {frame}", expected)
    if capture.digest == other.digest:
        raise InputError(other.path, "the capture that was trained on", "one in another light")
