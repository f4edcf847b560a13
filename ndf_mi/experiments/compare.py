"""Methods compared on one capture, on images that none of them was trained on: a run with others, or all
trained here.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import protocols
from ndf_mi.experiments.core import SILENT, Progress
from ndf_mi.experiments.evaluate import ImageSet, Measurement
from ndf_mi.experiments.fit import fitted
from ndf_mi.experiments.records import Results, Trained
from ndf_mi.experiments.resources import size_on_disk
from ndf_mi.experiments.settings import Evaluation, at_least, positive
from ndf_mi.experiments.store import Store
from ndf_mi.learn.loop import expect_capture
from ndf_mi.methods.base import Budget, Method, expect_views
from ndf_mi.methods.registry import CONVERGED, EQUAL_TIME, MethodSpec, entry, parse_specs
from ndf_mi.run import Run

RESULTS = "compare.json"
WORK = "compare"
PICTURES = "pictures"
RUN_METHOD = "ndf"
"""The method that, named without a folder, is the run itself."""
METHODS = ("ndf", "mesh", "offset-mesh")
_ENDS = {CONVERGED: "to convergence", EQUAL_TIME: "equal time"}
_SAME_TIME = 0.01
"""Relative difference below which two training times of a run that went on for a moment count as the same."""


@dataclass(frozen=True)
class Settings(Evaluation):
    """What is compared, and how.

    Attributes:
        methods: the methods, as `ndf_mi.methods.registry.parse_spec` reads them.
        seconds: training time of the methods of equal time; None takes the run's own. Methods without a
            budget of their own are trained for this time alone if it is given.
        texture: texels a side of the meshes' textures.
        seeds: trainings of each method that is trained here, with `seed` and the following ones.
    """

    methods: tuple[str, ...] = METHODS
    seconds: float | None = None
    texture: int = 512
    seeds: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least(self, texture=1, seeds=1)
        positive(self, "seconds")
        parse_specs(self.methods)


@dataclass(frozen=True)
class Ready:
    """A method that is ready to render.

    Attributes:
        name: in the study.
        label: for readers.
        method: trained or loaded.
        group: the name without its seed; empty if the method is loaded.
        peak_memory: bytes that its training took at most, where that is known.
    """

    name: str
    label: str
    method: Method
    group: str = ""
    peak_memory: int | None = None


class Comparison:
    """One comparison in one folder.

    Args:
        run: folder of a run; None if all methods are trained here.
        capture: folder of the capture, on which the run was trained.
        folder: where `compare.json` goes; pictures and trained methods go to its subfolder `compare`.
        settings: what is compared, and how.
        command: the command that the report names.

    Raises:
        InputError: run, capture or a method's folder cannot be read, they do not belong together, a method
            lacks images that would be measured, or the folder's `compare.json` cannot be read. Nothing has
            been written then.
    """

    def __init__(
        self, run: str | os.PathLike[str] | None, capture: str | os.PathLike[str],
        folder: str | os.PathLike[str], settings: Settings, command: str,
    ) -> None:
        self._work = Path(folder) / WORK
        self.pictures = self._work / PICTURES
        self.settings = settings
        self._specs = parse_specs(settings.methods)
        self._run = None if run is None else Run.load(run)
        self.capture = Capture.read(capture)
        if self._run is not None:
            expect_capture(self._run, self.capture)
        self._options = {"texture": settings.texture, "samples": settings.samples}
        self._seconds = self._equal_seconds()
        self._images = ImageSet.choose(self.capture, settings)
        self._loaded = {
            spec.name: self._load(spec, place)
            for spec in self._specs
            if (place := self._folder(spec)) is not None
        }
        self._store = Store(Path(folder) / RESULTS, "comparison")
        self.results = Results(self._about(command))
        self._tuned: dict[str, dict[str, Any]] = {}

    def run(self, progress: Progress = SILENT) -> Results:
        """Trains and measures what is missing or stale. `compare.json` is written after each unit."""
        self._store.about, self._store.summary = self.results.about, self.results.summary
        self.results.methods = []
        # One after another, so that none stays in memory while the next is trained.
        for ready in (ready for spec in self._specs for ready in self._ready(spec, progress)):
            result = Measurement(ready.name, ready.label, ready.method, self._images, self.pictures).run(
                self._store, progress)
            result.group = ready.group
            result.metadata |= {"peak_memory": ready.peak_memory, "size_on_disk": size_on_disk(ready.method)}
            self.results.methods.append(result)
        self._store.write()
        return self.results

    def _ready(self, spec: MethodSpec, progress: Progress) -> Iterator[Ready]:
        """The methods that a spec stands for, ready to render; one for each seed where they are trained."""
        if spec.name in self._loaded:
            method = self._loaded[spec.name]
            yield Ready(spec.name, method.label, method)
            return
        for seed in range(self.settings.seed, self.settings.seed + self.settings.seeds):
            yield from self._trained(spec, seed, progress)

    def _trained(self, spec: MethodSpec, seed: int, progress: Progress) -> list[Ready]:
        """A method trained with one seed. Without a budget and a time these are the one trained for equal
        time and the one trained to convergence, or only the latter if it converged within that time."""
        if spec.budget is not None or self.settings.seconds is not None:
            return [self._fitted(spec.key, spec.budget or EQUAL_TIME, seed, progress)]
        converged = self._fitted(spec.key, CONVERGED, seed, progress)
        metadata = converged.method.metadata()
        if metadata.get("converged") and metadata["seconds"] <= self._seconds:
            return [converged]
        return [self._fitted(spec.key, EQUAL_TIME, seed, progress), converged]

    def _fitted(self, key: str, end: str, seed: int, progress: Progress) -> Ready:
        """A method trained to an end, or loaded if it has been."""
        group, others = f"{key}-{end}", self.settings.seeds > 1
        name = group if seed == self.settings.seed else f"{group}-seed{seed}"
        # Another training of the same method has searched its options already.
        method = entry(key).create({**self._options, **self._tuned.get(key, {})})
        label = f"{method.label}, {_ENDS[end]}"
        budget = Budget(None if end == CONVERGED else self._budget(name), seed)
        fitted(
            method, name, f"train {label}" + (f", seed {seed}" if others else ""),
            entry(key).accepted(self._options), self.capture, budget, self._work / name, self._store,
            progress,
        )
        self._tuned[key] = method.metadata().get("tuned", {})
        record = self._store.matching(f"{name}/train", Trained).get(f"{name}/train")
        return Ready(name, label, method, group, None if record is None else record.peak_memory)

    def _budget(self, name: str) -> float:
        """Seconds of equal time: those of an earlier training if the run has hardly been trained since."""
        known: float | None = self._store.inputs(f"{name}/train").get("budget")
        if self.settings.seconds is not None or not known:
            return self._seconds
        return known if abs(known - self._seconds) <= _SAME_TIME * self._seconds else self._seconds

    def _folder(self, spec: MethodSpec) -> Path | None:
        """Where a method is loaded from, or None if it is trained."""
        itself = (spec.key, spec.folder, spec.budget) == (RUN_METHOD, None, None)
        return self._run.path if itself and self._run is not None else spec.folder

    def _load(self, spec: MethodSpec, folder: Path) -> Method:
        method = entry(spec.key).create(self._options)
        method.load(folder, self.capture)
        expect_views(method, [(view.camera, view.frame) for view in self._images.rendered()])
        return method

    def _equal_seconds(self) -> float:
        """The time of equal-time trainings, in seconds; 0 if there are none."""
        trained = [spec for spec in self._specs if self._folder(spec) is None and spec.budget != CONVERGED]
        of_run = None if self._run is None else (self._run.config.get("trained") or {}).get("seconds")
        seconds = self.settings.seconds or of_run or 0.0
        if trained and not seconds:
            repair = "Give the training time of the methods: --seconds 600"
            if self._run is None:
                raise InputError("option seconds", "none",
                                 "a training time, as there is no run to take it from", repair)
            where = f"{self._run.path / 'config.json'}: trained"
            raise InputError(where, "no training time", "the seconds of `ndf-mi optimise`", repair)
        return float(seconds)

    def _about(self, command: str) -> dict[str, Any]:
        protocol = protocols.named(self.settings.protocol)
        training = None if self._run is None else self._run.config.get("training")
        return {
            "run": None if self._run is None else str(self._run.path),
            **self._images.about(asdict(self.settings), command),
            "protocol": protocol.metadata(training, self.capture, self.settings.max_images),
            "equal_seconds": self._seconds,
        }
