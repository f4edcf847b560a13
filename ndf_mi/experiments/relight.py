"""A run that was trained under one light, shown under it and under another, beside a diffuse textured mesh."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ndf_mi import machine
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments.compare import PICTURES, Watcher
from ndf_mi.experiments.evaluate import choose_views, evaluate, measured
from ndf_mi.experiments.records import MethodResult, Results, View
from ndf_mi.methods.base import Budget, Light, Renderer
from ndf_mi.methods.lit_field import RelightableField
from ndf_mi.methods.lit_mesh import RelightableMesh
from ndf_mi.render.lights import lights

SEEN, UNSEEN = "seen", "unseen"
LIGHTINGS = (SEEN, UNSEEN)
WORK = "relight"
REPORT = "report.html"
MESH = "mesh"


@dataclass(frozen=True)
class Settings:
    """How to relight.

    Attributes:
        spp: samples a pixel, an even number.
        max_images: images measured of each held-out split; None for all.
        texture: texels a side of the mesh's reflectance.
        lattice: spacing in metres of the lattice that the field is shown on; 0 shows the field itself.
        seed: of the choice of images and of the mesh's training.
    """

    spp: int = 256
    max_images: int | None = None
    texture: int = 256
    lattice: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.spp < 2 or self.spp % 2:
            raise InputError("option spp", repr(self.spp), "an even number from 2 on")
        for key in ("max_images", "texture"):
            if getattr(self, key) is not None and getattr(self, key) < 1:
                raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), "at least 1")
        if not 0 <= self.lattice < float("inf"):
            raise InputError("option lattice", repr(self.lattice), "a length in metres, or 0")
        if self.seed < 0:
            raise InputError("option seed", repr(self.seed), "a whole number from 0 on")


class Relighting:
    """One such comparison in one folder; `run` does what is still missing of it.

    Args:
        run: folder of a run that was trained through scattering.
        capture: folder of the capture that it was trained on.
        under: folder of a capture of the same performance in another light; nothing is learnt from it.
        folder: where `seen.json`, `unseen.json` and `report.html` go; pictures and the mesh go to its subfolder `relight`.
        settings: how to.
        command: the command that the report says made it.

    Raises:
        InputError: run or captures can't be read, don't belong together or lack what is needed.
    """

    def __init__(
        self, run: str | os.PathLike[str], capture: str | os.PathLike[str], under: str | os.PathLike[str], folder: str | os.PathLike[str],
        settings: Settings, command: str,
    ) -> None:
        self.folder = Path(folder)
        self.settings = settings
        self._run = Path(run)
        self.captures = {SEEN: Capture.read(capture), UNSEEN: Capture.read(under)}
        self._field = RelightableField(settings.lattice)
        self._field.load(run, self.captures[SEEN])
        _expect_same_performance(self.captures[SEEN], self.captures[UNSEEN])
        self._lights = {name: Light(name, lights(known.known_lighting())) for name, known in self.captures.items()}
        self._views = {name: _held_out(choose_views(known, settings.max_images, settings.seed)) for name, known in self.captures.items()}
        self.results = {name: self._known(name, command) for name in LIGHTINGS}

    def pictures(self, lighting: str) -> Path:
        """The folder of the pictures under a light, one folder a method."""
        return self.folder / WORK / PICTURES / lighting

    def run(self, watcher: Watcher) -> dict[str, Results]:
        """Trains the mesh, measures both methods under both lights; a JSON file is written after each image."""
        mesh = self._mesh(watcher)
        for lighting in LIGHTINGS:
            frames = sorted({view.frame for view in self._views[lighting]})
            for method in (self._field, mesh):
                self._measure(lighting, method.under(self._lights[lighting], frames, self.settings.spp), watcher)
        return self.results

    def _mesh(self, watcher: Watcher) -> RelightableMesh:
        """The mesh, from the folder if one of the same settings is there."""
        settings, capture, folder = self.settings, self.captures[SEEN], self.folder / WORK / MESH
        if (folder / "mesh.json").exists():
            mesh = RelightableMesh()
            mesh.load(folder, capture)
            facts = mesh.metadata()
            if (facts["size"], facts["seed"]) == (settings.texture, settings.seed):
                return mesh
        mesh = RelightableMesh(settings.texture)
        budget = Budget(None, settings.seed)
        mesh.fit(capture, budget, lambda seconds, step, loss: watcher.training("diffuse mesh", seconds, None, step, loss))
        mesh.save(folder)
        return mesh

    def _measure(self, lighting: str, method: Renderer, watcher: Watcher) -> None:
        results, views, key = self.results[lighting], self._views[lighting], method.key
        known = results.method(key)
        result = MethodResult(key, method.label, method.cache_key(), method.metadata())
        if known is not None and known.cache_key == result.cache_key:
            result.images = known.images
            result.metadata["noise_psnr"] = known.metadata.get("noise_psnr")
        results.methods = [other for other in results.methods if other.key != key] + [result]

        def done() -> None:
            result.metadata = method.metadata()
            results.write(self.folder / f"{lighting}.json")
            watcher.measured(f"{method.label}, {lighting} light", len(result.images), len(views))

        evaluate(method, result, self.captures[lighting], views, self.pictures(lighting) / key, done)
        results.write(self.folder / f"{lighting}.json")

    def _known(self, lighting: str, command: str) -> Results:
        file = self.folder / f"{lighting}.json"
        known = Results.read(file) if file.exists() else Results()
        capture = self.captures[lighting]
        about = {
            "run": str(self._run),
            "capture": {"name": capture.name, "path": str(capture.path), "digest": capture.digest},
            "measured": measured(self._views[lighting], ()),
            "settings": asdict(self.settings),
            "command": command,
            "machine": machine.describe(),
        }
        return Results(about, known.methods)


def _held_out(views: list[View]) -> list[View]:
    return [view for view in views if view.split != "train"]


def _expect_same_performance(capture: Capture, other: Capture) -> None:
    """Raises InputError unless both captures show the same body in the same poses, as far as `other` goes."""
    where = f"{other.path / 'poses.npz'}"
    if not np.array_equal(capture.body.faces, other.body.faces):
        raise InputError(other.path / "body.npz", "another body", f"that of {capture.path}")
    for frame in other.poses.frames:
        if frame not in capture.poses.frames:
            raise InputError(where, f"frame {frame}, which {capture.path} lacks", "the same performance in another light")
        if not np.allclose(other.poses.vertices[other.poses.index(frame)], capture.poses.vertices[capture.poses.index(frame)], atol=1e-5):
            raise InputError(where, f"another pose in frame {frame}", f"that of {capture.path}: the same performance in another light")
    if capture.digest == other.digest:
        raise InputError(other.path, "the capture that was trained on", "one in another light")
