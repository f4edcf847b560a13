"""Rendering methods on held-out views and poses, and measuring the images against the truth."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from PIL import Image

from ndf_mi import files, machine
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.experiments.core import Progress, Unit, fresh_records, run_units
from ndf_mi.experiments.flicker import choose_sequences, measure_flicker
from ndf_mi.experiments.protocols import DEFAULT, Protocol, named
from ndf_mi.experiments.records import SPLITS, Flicker, FrameSequence, Measured, MethodResult, View
from ndf_mi.experiments.settings import Evaluation
from ndf_mi.experiments.store import Store
from ndf_mi.methods.base import Renderer

TRAINING_IMAGES = 4
"""Training images that are measured along with the held-out ones; they show how well a method fits what it
has seen.
"""


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
            split = replace(split, frames=protocol.frames(split))
        pairs = [View(name, camera, frame) for camera, frame in split]
        count = len(pairs) if limit is None else limit
        order = np.random.default_rng([seed, index]).permutation(len(pairs))
        chosen += [
            pairs[i] for i in sorted(order[: min(count, TRAINING_IMAGES) if name == "train" else count])
        ]
    if not any(view.split != "train" for view in chosen):
        raise InputError(
            f"{capture.path}: splits", "no novel_view or novel_pose", "held-out images to compare on"
        )
    return chosen


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
        return list(
            dict.fromkeys([*self.views, *(view for sequence in self.sequences for view in sequence.views)])
        )

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


def image_units(
    name: str, label: str, method: Renderer, images: ImageSet, pictures: Path
) -> list[Unit[Measured]]:
    """A unit for each image of one method: it renders the image, measures it, and writes its picture.

    Args:
        name: the method's name in the study.
        label: what progress reports call it.
        method: what renders.
        images: which images.
        pictures: the method's folder for 8-bit PNG pictures; metrics of single images are of unrounded
            values.
    """
    inputs, sampled = _inputs(method, images), images.sampled()

    def unit(view: View) -> Unit[Measured]:
        def work() -> Measured:
            return structs.replace(_measure(method, images.capture, view, pictures), sampled=view in sampled)

        key = f"{name}/image/{view.split}/{view.camera}/{view.frame:06d}"
        return Unit(key, inputs, work, Measured, (pictures / view.file,), f"render {label}")

    return [unit(view) for view in images.rendered()]


def flicker_units(
    name: str, label: str, method: Renderer, images: ImageSet, pictures: Path
) -> list[Unit[Flicker]]:
    """A unit for each sequence of one method, whose pictures must exist; arguments as of `image_units`."""

    def unit(sequence: FrameSequence) -> Unit[Flicker]:
        inputs = {**_inputs(method, images), **structs.asdict(sequence)}
        return Unit(
            f"{name}/flicker/{sequence.split}", inputs,
            lambda: measure_flicker(images.capture, sequence, pictures), Flicker, (),
            f"compare frames of {label}",
        )

    return [unit(sequence) for sequence in images.sequences]


def measure(
    name: str, label: str, method: Renderer, images: ImageSet, pictures: Path, store: Store,
    progress: Progress,
) -> MethodResult:
    """Measures what is missing or stale of one method.

    Args:
        label: its name in tables.
        pictures: the folder for pictures, one folder a method.
        store: where records are kept.
    """
    measured = run_units(image_units(name, label, method, images, pictures / name), store, progress)
    flicker = run_units(flicker_units(name, label, method, images, pictures / name), store)
    return _result(name, label, method, images, measured, flicker)


def already_measured(
    name: str, label: str, method: Renderer, images: ImageSet, pictures: Path, store: Store
) -> MethodResult | None:
    """The result of a method if all of its images and sequences are there and fresh, else None; arguments as
    of `measure`.
    """
    measured = fresh_records(image_units(name, label, method, images, pictures / name), store)
    flicker = fresh_records(flicker_units(name, label, method, images, pictures / name), store)
    return (
        None
        if measured is None or flicker is None
        else _result(name, label, method, images, measured, flicker)
    )


def _result(
    name: str, label: str, method: Renderer, images: ImageSet, measured: list[Measured],
    flicker: list[Flicker],
) -> MethodResult:
    # Whether an image counts in the means depends on what is asked for now.
    sampled = images.sampled()
    measured = [structs.replace(image, sampled=image.view in sampled) for image in measured]
    noise = [10 ** (-image.noise / 10) for image in measured if image.noise is not None]
    metadata = {key: value for key, value in method.metadata().items() if key != "noise_psnr"}
    if noise:
        metadata["noise_psnr"] = -10 * float(np.log10(np.mean(noise)))
    return MethodResult(name, label, method.cache_key(), metadata, measured, flicker)


def _inputs(method: Renderer, images: ImageSet) -> dict[str, Any]:
    return {"images": method.cache_key(), "capture": images.capture.digest}


def _measure(method: Renderer, capture: Capture, view: View, pictures: Path) -> Measured:
    camera = capture.cameras[view.camera]
    start = time.perf_counter()
    image = method.render(camera, view.frame)
    seconds = time.perf_counter() - start
    mask = metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])
    figures = metrics.measure(capture.image(view.camera, view.frame), image, mask)
    save_picture(pictures / view.file, image)
    return Measured(view, seconds, figures, noise=method.metadata().get("noise_psnr"))


def save_picture(file: Path, image: np.ndarray) -> None:
    """Writes (h, w, 3) sRGB, cut to [0, 1], as 8-bit PNG."""
    with files.replacing(file) as beside:
        Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(beside)
