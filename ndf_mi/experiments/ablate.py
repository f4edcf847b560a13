"""The ablation study: all variants of the method, trained on one capture and measured on held-out images."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import protocols
from ndf_mi.experiments.core import SILENT, Progress, run_units
from ndf_mi.experiments.evaluate import ImageSet, Measurement
from ndf_mi.experiments.fit import training_unit
from ndf_mi.experiments.records import MethodResult, Results
from ndf_mi.experiments.settings import Evaluation
from ndf_mi.experiments.store import Store
from ndf_mi.field import Preset
from ndf_mi.learn.ablations import ABLATIONS, ablation
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.trained import expect_options, is_trained
from ndf_mi.methods.registry import entry
from ndf_mi.run import Run

RESULTS = "ablation.json"
PICTURES = "pictures"
FULL = "full"
"""The variant that the others are compared with."""


class AblationStudy:
    """A study in one folder. Rows of variants that are not asked for now stay in the table while they are
    comparable: trained with the same options on the same capture, and measured on the same images.

    Args:
        capture: folder of the capture.
        folder: where `ablation.json`, the pictures and a run for each variant go.
        names: the variants; `full` is always added.
        preset, options: of the full model; each variant changes them.
        settings: how variants are measured.
        command: the command that the report names.

    Raises:
        InputError: the capture cannot be read, a variant does not exist, or the folder holds runs with other
            options.
    """

    def __init__(
        self, capture: str | os.PathLike[str], folder: str | os.PathLike[str], names: Sequence[str],
        preset: Preset, options: TrainingOptions, settings: Evaluation, command: str,
    ) -> None:
        self.folder = Path(folder)
        self.pictures = self.folder / PICTURES
        self.capture = Capture.read(capture)
        self.names = [FULL, *(name for name in dict.fromkeys(names) if name != FULL)]
        self._settings = settings
        self._full = preset, options
        self._images = ImageSet.choose(self.capture, settings)
        for name in self.names:
            ablation(name)
            if (self.folder / name / "config.json").exists():
                expect_options(Run.load(self.folder / name), self.capture, *self._wanted(name))
        self._store = Store(self.folder / RESULTS, "ablation")
        rows = [row for name in ABLATIONS if (row := self._earlier(name)) is not None]
        self.results = Results(self._about(command), rows)

    def run(self, progress: Progress = SILENT) -> Results:
        """Trains and measures what is missing or stale, one variant after the other.

        Raises:
            KeyboardInterrupt: stopped by a signal; the same study continues where it stopped.
        """
        self._store.about, self._store.summary = self.results.about, self.results.summary
        for name in self.names:
            label, (preset, options) = f"train {ablation(name).title}", self._wanted(name)
            unit = training_unit(name, label, self.folder / name, self.capture, preset, options)
            run_units([unit], self._store, progress)
            row = self._measurement(name).run(self._store, progress)
            rows = [*(other for other in self.results.methods if other.key != name), row]
            self.results.methods = sorted(rows, key=lambda row: list(ABLATIONS).index(row.key))
        self._store.write()
        return self.results

    def _wanted(self, name: str) -> tuple[Preset, TrainingOptions]:
        return ablation(name).apply(*self._full)

    def _measurement(self, name: str) -> Measurement:
        method = entry("ndf").create({"samples": self._settings.samples})
        method.load(self.folder / name, self.capture)
        return Measurement(name, ablation(name).title, method, self._images, self.pictures)

    def _earlier(self, name: str) -> MethodResult | None:
        """The row of a variant that was trained and measured earlier just as is asked for now, or None."""
        try:
            if not is_trained(self.folder / name):
                return None
            expect_options(Run.load(self.folder / name), self.capture, *self._wanted(name))
            return self._measurement(name).stored(self._store)
        except InputError:
            return None

    def _about(self, command: str) -> dict[str, Any]:
        preset, options = self._full
        protocol, training = protocols.named(self._settings.protocol), options.to_dict()
        return {
            **self._images.about(self._settings.to_dict(), command),
            "protocol": protocol.metadata(training, self.capture, self._settings.max_images),
            "preset": preset.to_dict(),
            "training": training,
        }
