"""A run beside the textured meshes on one capture: trains and measures what is missing, writes the report."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from ndf_mi import machine
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import protocols
from ndf_mi.experiments.evaluate import choose_views, evaluate, measured, to_render
from ndf_mi.experiments.flicker import choose_sequences
from ndf_mi.experiments.records import MethodResult, Results
from ndf_mi.methods import registry
from ndf_mi.methods.base import Budget, Method, Renderer
from ndf_mi.reports.compare import write_report
from ndf_mi.run import Run

RESULTS = "compare.json"
REPORT = "report.html"
WORK = "compare"
PICTURES = "pictures"
OFFSETS = ("all", "equal-time", "none")


@dataclass(frozen=True)
class Settings:
    """How to compare.

    Attributes:
        mesh_seconds: time for the meshes of equal time; None takes the run's own training time.
        max_images: images measured of each held-out split; None takes the protocol's number, 48 for `ours`.
        texture: texels a side of the meshes' textures.
        samples: candidate samples a ray of the field.
        seed: of the choice of images and of the meshes' training.
        protocol: name of the protocol that images are chosen by.
        sequence: successive frames a split that temporal consistency is measured on; 0 leaves it out.
        offsets: the mesh with vertex offsets: `all` trains it as the other one, `equal-time` for the equal time only,
            `none` leaves it out.
    """

    mesh_seconds: float | None = None
    max_images: int | None = None
    texture: int = 512
    samples: int = 128
    seed: int = 0
    protocol: str = protocols.OURS.name
    sequence: int = 12
    offsets: str = "all"

    def __post_init__(self) -> None:
        if self.offsets not in OFFSETS:
            raise InputError("option offsets", repr(self.offsets), f"one of {', '.join(OFFSETS)}")
        for key in ("max_images", "texture", "samples"):
            if getattr(self, key) is not None and getattr(self, key) < 1:
                raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), "at least 1")
        if self.sequence < 0 or self.sequence == 1:
            raise InputError("option sequence", repr(self.sequence), "at least 2, or 0 to leave temporal consistency out")
        protocols.named(self.protocol)
        if self.mesh_seconds is not None and not 0 < self.mesh_seconds < float("inf"):
            raise InputError("option mesh-seconds", repr(self.mesh_seconds), "a number of seconds above 0")
        if self.seed < 0:
            raise InputError("option seed", repr(self.seed), "a whole number from 0 on")


class Watcher(Protocol):
    """Told how the work goes on."""

    def training(self, label: str, seconds: float, budget: float | None, step: int, loss: float) -> None:
        """A step of a mesh's training is done; `loss` is its sRGB mean squared error."""
        ...

    def measured(self, label: str, done: int, of: int) -> None:
        """Images of a method are measured."""
        ...


class Comparison:
    """One comparison in one folder; `run` does what is still missing of it.

    Args:
        run: folder of a run.
        capture: folder of the capture that it was trained on.
        folder: where `compare.json` and `report.html` go; pictures and meshes go to its subfolder `compare`.
        settings: how to compare.
        command: the command that the report says made it.

    Raises:
        InputError: run or capture can't be read, they don't belong together, or the folder's `compare.json` can't be read. What it holds
            of another run or with other settings is no error: what is rendered otherwise is measured anew, and the rest is of use.
    """

    def __init__(
        self,
        run: str | os.PathLike[str],
        capture: str | os.PathLike[str],
        folder: str | os.PathLike[str],
        settings: Settings,
        command: str,
    ) -> None:
        self.folder = Path(folder)
        self._work = self.folder / WORK
        self.settings = settings
        self._run = Run.load(run)
        self._capture = Capture.read(capture)
        self._field = registry.entry("ndf").create({"samples": settings.samples})
        self._field.load(run, self._capture)
        self._budget = self._mesh_seconds()
        self._tuned: dict[str, Any] = {}
        self._protocol = protocols.named(settings.protocol)
        self._views = choose_views(self._capture, settings.max_images, settings.seed, self._protocol)
        self._sequences = choose_sequences(self._capture, settings.sequence)
        known = Results.read(self.folder / RESULTS) if (self.folder / RESULTS).exists() else Results()
        self.results = Results(self._about(command), known.methods)

    def run(self, watcher: Watcher) -> Results:
        """Trains the meshes, measures every method; `compare.json` after each image, `report.html` at the end."""
        meshes = self._meshes("mesh", watcher, converge=True)
        if self.settings.offsets != "none":
            meshes |= self._meshes("offset-mesh", watcher, converge=self.settings.offsets == "all")
        self._measure("ndf", self._field.label, self._field, watcher)
        for key, (mesh, label) in meshes.items():
            self._measure(key, label, mesh, watcher)
        self.results.methods = [method for method in self.results.methods if method.key in {"ndf", *meshes}]
        self.results.write(self.folder / RESULTS)
        write_report(self.folder / REPORT, self.results, self._capture, self._work / PICTURES)
        return self.results

    def _meshes(self, key: str, watcher: Watcher, converge: bool) -> dict[str, tuple[Method, str]]:
        """The meshes of a kind and their labels, by their keys."""
        meshes: dict[str, tuple[Method, str]] = {}
        if converge:
            converged = self._mesh(key, f"{key}-converged", None, watcher)
            meshes = {f"{key}-converged": (converged, f"{converged.label}, to convergence")}
            if self._stands_for_equal_time(converged):
                return meshes
        equal = self._mesh(key, f"{key}-equal-time", self._budget, watcher)
        return {f"{key}-equal-time": (equal, f"{equal.label}, equal time"), **meshes}

    def _stands_for_equal_time(self, converged: Method) -> bool:
        """Whether the converged mesh took no longer than the run, so that equal time has nothing to add to it.

        A budget that the user gave is always trained for.
        """
        facts = converged.metadata()
        return self.settings.mesh_seconds is None and facts["converged"] and facts["seconds"] <= self._budget

    def _mesh(self, kind: str, key: str, budget: float | None, watcher: Watcher) -> Method:
        """The mesh of this kind and budget, from the folder if one of the same settings is there."""
        folder = self._work / key
        wanted: dict[str, Any] = {"size": self.settings.texture, "seed": self.settings.seed}
        options = {"texture": self.settings.texture, **self._tuned}
        mesh = registry.entry(kind).create(options)
        if (folder / "mesh.json").exists():
            mesh.load(folder, self._capture)
            facts = mesh.metadata()
            if all(facts[name] == value for name, value in wanted.items()) and self._same_time(facts["budget"], budget):
                self._tuned |= facts["tuned"]
                return mesh
            mesh = registry.entry(kind).create(options)
        label = f"{mesh.label.lower()} {'to convergence' if budget is None else 'of equal time'}"
        mesh.fit(
            self._capture,
            Budget(budget, self.settings.seed),
            lambda seconds, step, loss: watcher.training(label, seconds, budget, step, loss),
        )
        mesh.save(folder)
        self._tuned |= mesh.metadata()["tuned"]
        return mesh

    def _same_time(self, trained: float | None, wanted: float | None) -> bool:
        """Whether a mesh's budget in seconds, None for convergence, is the one wanted: within a hundredth where that is the run's own
        time, which never ends on the second, and exactly where the user gave it."""
        if trained is None or wanted is None or self.settings.mesh_seconds is not None:
            return trained == wanted
        return abs(trained - wanted) <= 0.01 * wanted

    def _measure(self, key: str, label: str, method: Renderer, watcher: Watcher) -> None:
        known = self.results.method(key)
        result = MethodResult(key, label, method.cache_key(), method.metadata())
        if known is not None and known.cache_key == result.cache_key:
            result.images = known.images
        # What an earlier call measured of the other methods stays, until their turn comes.
        self.results.methods = [method for method in self.results.methods if method.key != key] + [result]

        images = len(to_render(self._views, self._sequences))

        def done() -> None:
            self.results.write(self.folder / RESULTS)
            watcher.measured(label, len(result.images), images)

        evaluate(method, result, self._capture, self._views, self._work / PICTURES / key, done, self._sequences)

    def _mesh_seconds(self) -> float:
        seconds = self.settings.mesh_seconds or self._field.metadata()["seconds"]
        if not seconds:
            raise InputError(
                f"{self._run.path / 'config.json'}: trained",
                "no training time",
                "the seconds that `ndf-mi optimise` writes when it ends",
                "Give the mesh's training time yourself: --mesh-seconds 600",
            )
        return float(seconds)

    def _about(self, command: str) -> dict[str, Any]:
        return {
            "run": str(self._run.path),
            "capture": {
                "name": self._capture.name,
                "path": str(self._capture.path),
                "digest": self._capture.digest,
                **{split: _extent(self._capture, split) for split in self._capture.splits},
            },
            "measured": measured(self._views, self._sequences),
            "protocol": self._protocol.facts(
                self._run.config.get("training"), self._capture, self.settings.max_images
            ),
            "equal_seconds": self._budget,
            "settings": asdict(self.settings),
            "command": command,
            "machine": machine.describe(),
        }


def _extent(capture: Capture, split: str) -> dict[str, int]:
    return {"cameras": len(capture.splits[split].cameras), "frames": len(capture.splits[split].frames)}
