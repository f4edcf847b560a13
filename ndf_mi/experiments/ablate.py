"""The ablation study: every variant of the method trained on one capture, measured on its held-out images, in one table."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ndf_mi import machine
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import protocols
from ndf_mi.experiments.evaluate import choose_views, evaluate, measured, to_render
from ndf_mi.experiments.flicker import choose_sequences
from ndf_mi.experiments.records import MethodResult, Results
from ndf_mi.experiments.trained import expect_options, read_options_of, trained
from ndf_mi.field import Preset
from ndf_mi.learn.ablations import ABLATIONS, ablation
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.methods.ndf import NeuralField
from ndf_mi.reports.ablate import write_ablation_report
from ndf_mi.run import Run

RESULTS = "ablation.json"
REPORT = "report.html"
PICTURES = "pictures"


@dataclass(frozen=True)
class Settings:
    """How variants are measured.

    Attributes:
        max_images: images measured of each held-out split; None takes the protocol's number, 48 for `ours`.
        sequence: successive frames of each split on which temporal consistency is measured; 0 for none.
        samples: candidate samples a ray.
        seed: of the choice of images.
        protocol: name of the protocol that images are chosen by.
    """

    max_images: int | None = None
    sequence: int = 12
    samples: int = 128
    seed: int = 0
    protocol: str = protocols.OURS.name

    def __post_init__(self) -> None:
        protocols.named(self.protocol)
        for key, least in (("max_images", 1), ("samples", 1), ("sequence", 0), ("seed", 0)):
            if getattr(self, key) is not None and getattr(self, key) < least:
                raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), f"a whole number from {least} on")
        if self.sequence == 1:
            raise InputError("option sequence", "1", "at least 2, or 0 to leave temporal consistency out")

    def to_dict(self) -> dict[str, Any]:
        """The settings as JSON values, with the protocol's number of images where none was given."""
        limit = protocols.named(self.protocol).max_images if self.max_images is None else self.max_images
        return asdict(self) | {"max_images": limit}


class Study:
    """An ablation study in one folder; :meth:`run` does what is still missing of it.

    Args:
        capture: folder of the capture.
        folder: where `ablation.json`, `report.html` and a run a variant go.
        names: the variants; the first, to which the others are compared, is always ``full``.
        preset, options: of the full model; each variant changes them.
        settings: how variants are measured.
        command: the command that the report says made it.

    Raises:
        InputError: the capture can't be read, a variant does not exist, or the folder holds runs of other options.
    """

    def __init__(self, capture: str | os.PathLike[str], folder: str | os.PathLike[str], names: Sequence[str], preset: Preset,
                 options: TrainingOptions, settings: Settings, command: str) -> None:
        self.folder = Path(folder)
        self._capture = Capture.read(capture)
        self._settings = settings
        self.names = ["full", *(name for name in dict.fromkeys(names) if name != "full")]
        self._full = (preset, options)
        self._wanted = {name: ablation(name).apply(*self._full) for name in self.names}
        self._protocol = protocols.named(settings.protocol)
        self._views = choose_views(self._capture, settings.max_images, settings.seed, self._protocol)
        self._sequences = choose_sequences(self._capture, settings.sequence)
        for name in self.names:
            if (self.folder / name / "config.json").exists():
                expect_options(Run.load(self.folder / name), self._capture, *self._wanted[name])
        known = Results.read(self.folder / RESULTS) if (self.folder / RESULTS).exists() else Results()
        # Images measured before are of use whatever is asked for now. Rows are kept only where they were measured alike.
        self._known = {method.key: method for method in known.methods}
        self.results = Results(self._about(command, preset, options))
        self.results.methods = [row for row in known.methods if self._alike(known.about) and self._complete(row)]

    def run(self, training: Callable[[str, int, int], None], measured: Callable[[str, int, int], None]) -> Results:
        """Trains and measures variant after variant; table and report are written after each.

        Args:
            training: told name, number and count of the variant whose training begins or goes on.
            measured: told title, images measured, and images in all.

        Raises:
            KeyboardInterrupt: stopped by a signal; the same study goes on where it was.
        """
        count = len(to_render(self._views, self._sequences))
        for number, name in enumerate(self.names, start=1):
            run = trained(self.folder / name, self._capture, *self._wanted[name],
                          lambda: training(name, number, len(self.names)))  # noqa: B023
            method = NeuralField.of(run, self._settings.samples)
            result = MethodResult(name, ablation(name).title, method.cache_key(), method.metadata())
            known = self._known.get(name)
            if known is not None and known.cache_key == result.cache_key:
                result.images = known.images
            others = [other for other in self.results.methods if other.key != name]
            self.results.methods = sorted([*others, result], key=lambda method: list(ABLATIONS).index(method.key))

            def done() -> None:
                self.results.write(self.folder / RESULTS)
                measured(result.label, len(result.images), count)  # noqa: B023

            evaluate(method, result, self._capture, self._views, self.folder / PICTURES / name, done, self._sequences)
            self.results.write(self.folder / RESULTS)
            write_ablation_report(self.folder / REPORT, self.results, self._capture, self.folder / PICTURES)
        return self.results

    def _alike(self, about: dict[str, Any]) -> bool:
        """Whether rows that go with `about` were trained and measured as is asked for now, on the same capture."""
        wanted = self.results.about
        digest = about.get("capture", {}).get("digest")
        # Studies written before there were protocols were measured by ours.
        settings = {"protocol": protocols.OURS.name, **about.get("settings", {})}
        try:
            preset, training = read_options_of(about, "")
        except InputError:
            return False
        return (digest, settings, preset, training) == (
            self._capture.digest, wanted["settings"], wanted["preset"], wanted["training"])  # fmt: skip

    def _complete(self, row: MethodResult) -> bool:
        """Whether a row can stay as it is: every image and sequence of now is measured, its picture there, and the run beside it is of
        the options that its variant has now and renders the same."""
        views, sequences = {image.view for image in row.images}, [flicker.sequence for flicker in row.flicker]
        if row.key not in ABLATIONS or not views.issuperset(to_render(self._views, self._sequences)) or sequences != self._sequences:
            return False
        if not all((self.folder / PICTURES / row.key / view.file).is_file() for view in views):
            return False
        try:
            run = Run.load(self.folder / row.key)
            expect_options(run, self._capture, *ablation(row.key).apply(*self._full))
        except InputError:
            return False
        return NeuralField.of(run, self._settings.samples).cache_key() == row.cache_key

    def _about(self, command: str, preset: Preset, options: TrainingOptions) -> dict[str, Any]:
        splits = self._capture.splits
        return {
            "capture": {"name": self._capture.name, "digest": self._capture.digest,
                        **{name: {"cameras": len(split.cameras), "frames": len(split.frames)} for name, split in splits.items()}},
            "measured": measured(self._views, self._sequences),
            "protocol": self._protocol.facts(options.to_dict(), self._capture, self._settings.max_images),
            "settings": self._settings.to_dict(),
            "preset": preset.to_dict(),
            "training": options.to_dict(),
            "command": command,
            "machine": machine.describe(),
        }
