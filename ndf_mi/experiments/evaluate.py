"""Rendering methods on held-out views and poses, and measuring the images against the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from PIL import Image

from ndf_mi import files, machine
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics, perceptual
from ndf_mi.experiments.core import SILENT, Progress, Unit, run_units
from ndf_mi.experiments.flicker import choose_sequences, measure_flicker
from ndf_mi.experiments.protocols import DEFAULT, Protocol, named
from ndf_mi.experiments.records import SPLITS, Flicker, FrameSequence, Measured, MethodResult, View
from ndf_mi.experiments.settings import Evaluation
from ndf_mi.experiments.store import Store
from ndf_mi.methods.base import Renderer

TRAINING_IMAGES = 4
"""Training images that are measured too; they show how well a method fits what it has seen."""


def choose_views(
    capture: Capture, max_images: int | None, seed: int = 0, protocol: Protocol = DEFAULT
) -> list[View]:
    """The images to measure: those of the protocol, or `max_images` of each held-out split at random; a few
    training images.

    A larger `max_images` draws the same images and more, so that earlier measurements stay of use. None takes
    the protocol's number. The split `sequence` is left out: its images are measured for temporal consistency.

    Raises:
        InputError: the capture has neither novel views nor novel poses, or lacks what the protocol needs.
    """
    protocol.check(capture)
    limit = protocol.max_images if max_images is None else max_images
    chosen: list[View] = []
    for index, name in enumerate(SPLITS):
        if name == "sequence":
            continue
        split = capture.splits[name]
        if name != "train":
            split = replace(split, frames=split.every(protocol.every))
        pairs = [View(name, camera, frame) for camera, frame in split]
        count = len(pairs) if limit is None else limit
        if name == "train":
            count = min(count, TRAINING_IMAGES)
        order = np.random.default_rng([seed, index]).permutation(len(pairs))
        chosen += [pairs[i] for i in sorted(order[:count])]
    if all(view.split == "train" for view in chosen):
        where = f"{capture.path}: splits"
        raise InputError(where, "no novel_view or novel_pose", "held-out images to compare on")
    return chosen


def held_out_views(capture: Capture, max_images: int | None, seed: int) -> list[View]:
    """The images of `choose_views` by the default protocol that no method was trained on."""
    return [view for view in choose_views(capture, max_images, seed) if view.split != "train"]


@dataclass(frozen=True)
class ImageSet:
    """The images of a capture that a study measures.

    Attributes:
        capture: the truth.
        views: the images that means are taken of, those of `sequences` apart.
        sequences: the frames that temporal consistency is measured on.
    """

    capture: Capture
    views: Sequence[View]
    sequences: Sequence[FrameSequence] = ()

    @classmethod
    def choose(cls, capture: Capture, settings: Evaluation) -> ImageSet:
        """The images by a study's settings. Raises InputError as `choose_views`."""
        views = choose_views(capture, settings.max_images, settings.seed, named(settings.protocol))
        return cls(capture, views, choose_sequences(capture, settings.sequence))

    def rendered(self) -> list[View]:
        """All images that are rendered, once each: the views, then those that only the sequences need."""
        return list(dict.fromkeys([*self.views, *(v for s in self.sequences for v in s.views)]))

    def sampled(self) -> set[View]:
        """The images that count in means: the views, and those of the split that is made for sequences."""
        own = {view for sequence in self.sequences if sequence.split == "sequence" for view in sequence.views}
        return set(self.views) | own

    def counts(self) -> dict[str, int]:
        """How many images count in the means of each split that has some."""
        found = {split: sum(view.split == split for view in self.sampled()) for split in SPLITS}
        return {split: count for split, count in found.items() if count}

    def about(self, settings: Mapping[str, Any], command: str) -> dict[str, Any]:
        """JSON values that describe a study: capture, numbers of images, settings, command and machine."""
        capture, splits = self.capture, self.capture.splits
        extents = {name: {"cameras": len(s.cameras), "frames": len(s.frames)} for name, s in splits.items()}
        return {
            "capture": {"name": capture.name, "path": str(capture.path), "digest": capture.digest, **extents},
            "measured": self.counts(),
            "settings": dict(settings),
            "command": command,
            "machine": machine.describe(),
        }


@dataclass(frozen=True)
class Measurement:
    """The measurement of one method: a unit of work for each image, then one for each sequence.

    Attributes:
        name: the method's name in the study.
        label: its name in tables.
        method: what renders.
        images: which images.
        pictures: the folder for 8-bit PNG pictures, one folder a method; metrics of single images are of
            unrounded values.
    """

    name: str
    label: str
    method: Renderer
    images: ImageSet
    pictures: Path

    def run(self, store: Store, progress: Progress = SILENT) -> MethodResult:
        """Renders and measures what is missing or stale in `store`."""
        images, sequences = self._units()
        measured = run_units(images, store, progress)
        return self._result(measured, run_units(sequences, store))

    def stored(self, store: Store) -> MethodResult | None:
        """The result if all images and sequences are there and fresh, else None."""
        images, sequences = self._units()
        measured = [image for unit in images if (image := store.fresh(unit)) is not None]
        flicker = [found for unit in sequences if (found := store.fresh(unit)) is not None]
        if len(measured) < len(images) or len(flicker) < len(sequences):
            return None
        return self._result(measured, flicker)

    def _result(self, measured: list[Measured], flicker: list[Flicker]) -> MethodResult:
        # Whether an image counts in the means depends on what is asked for now.
        sampled = self.images.sampled()
        measured = [structs.replace(image, sampled=image.view in sampled) for image in measured]
        noise = [10 ** (-image.noise / 10) for image in measured if image.noise is not None]
        metadata = {key: value for key, value in self.method.metadata().items() if key != "noise_psnr"}
        if noise:
            metadata["noise_psnr"] = -10 * float(np.log10(np.mean(noise)))
        return MethodResult(self.name, self.label, self.method.cache_key(), metadata, measured, flicker)

    def _units(self) -> tuple[list[Unit[Measured]], list[Unit[Flicker]]]:
        capture, pictures = self.images.capture, self.pictures / self.name
        inputs: dict[str, Any] = {"images": self.method.cache_key(), "capture": capture.digest}
        # Images that were measured without LPIPS are measured again once it can be.
        lpips = {} if perceptual.absence() else {"lpips": True}
        images = [
            Unit(
                f"{self.name}/image/{view.split}/{view.camera}/{view.frame:06d}", {**inputs, **lpips},
                partial(self._measure, view), Measured, (pictures / view.file,), f"render {self.label}",
            )
            for view in self.images.rendered()
        ]
        sequences = [
            Unit(
                f"{self.name}/flicker/{sequence.split}", {**inputs, **structs.asdict(sequence)},
                partial(measure_flicker, capture, sequence, pictures), Flicker,
                label=f"compare frames of {self.label}",
            )
            for sequence in self.images.sequences
        ]
        return images, sequences

    def _measure(self, view: View) -> Measured:
        capture, method = self.images.capture, self.method
        camera = capture.cameras[view.camera]
        start = time.perf_counter()
        image = method.render(camera, view.frame)
        seconds = time.perf_counter() - start
        mask = metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])
        figures = metrics.measure(capture.image(view.camera, view.frame), image, mask)
        save_picture(self.pictures / self.name / view.file, image)
        sampled = view in self.images.sampled()
        return Measured(view, seconds, figures, sampled, method.metadata().get("noise_psnr"))


def save_picture(file: Path, image: np.ndarray) -> None:
    """Writes (h, w, 3) sRGB, cut to [0, 1], as 8-bit PNG."""
    with files.replacing(file) as beside:
        Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(beside)
