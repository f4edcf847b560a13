"""Rendering methods on held-out views and poses, and measuring them against the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from msgspec import structs
from PIL import Image

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.experiments.flicker import measure_flicker
from ndf_mi.experiments.protocols import OURS, Protocol
from ndf_mi.experiments.records import FrameSequence, Measured, MethodResult, View
from ndf_mi.methods.base import Renderer

SPLITS = ("novel_view", "novel_pose", "sequence", "train")
LABELS = {"novel_view": "novel views", "novel_pose": "novel poses", "sequence": "successive frames", "train": "training views"}
#: Training images that are measured, beside the held-out ones, to show how far a method follows what it has seen.
TRAINING_IMAGES = 4


def choose_views(capture: Capture, max_images: int | None, seed: int = 0, protocol: Protocol = OURS) -> list[View]:
    """The images to measure: of novel views and poses all of the protocol's or `max_images`, drawn at random; a few training images.

    The split `sequence` is not among them: all of its images are measured with the temporal consistency.

    A larger `max_images` draws the same images and more, so that what was measured stays of use. None takes the protocol's number.

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
        chosen += [pairs[i] for i in sorted(order[: min(count, TRAINING_IMAGES) if name == "train" else count])]
    if not any(view.split != "train" for view in chosen):
        raise InputError(f"{capture.path}: splits", "no novel_view or novel_pose", "held-out images to compare on")
    return chosen


def to_render(views: Sequence[View], sequences: Sequence[FrameSequence]) -> list[View]:
    """The images that `evaluate` renders, once each: `views`, then what the sequences have beside them."""
    return list(dict.fromkeys([*views, *(view for sequence in sequences for view in sequence.views)]))


def measured(views: Sequence[View], sequences: Sequence[FrameSequence]) -> dict[str, int]:
    """How many images of each split count in its means: `views`, and those of the split that is made for sequences."""
    counted = _counted(views, sequences)
    return {split: sum(view.split == split for view in counted) for split in SPLITS if any(view.split == split for view in counted)}


def _counted(views: Sequence[View], sequences: Sequence[FrameSequence]) -> set[View]:
    return set(views) | {view for sequence in sequences if sequence.split == "sequence" for view in sequence.views}


def evaluate(
    method: Renderer,
    result: MethodResult,
    capture: Capture,
    views: Sequence[View],
    pictures: Path,
    done: Callable[[], None],
    sequences: Sequence[FrameSequence] = (),
) -> None:
    """Renders and measures what `result` lacks, and leaves exactly the images of `to_render` in it, in their order.

    Args:
        method: what renders.
        result: where figures go, image by image, and at the end those of the sequences.
        capture: the truth.
        views: what the means are of.
        pictures: folder for the pictures, as 8-bit PNG; figures of single images are of the unrounded ones.
        done: called after each new image.
        sequences: what temporal consistency is measured on.
    """
    known = {image.view: image for image in result.images if (pictures / image.view.file).is_file()}
    wanted, sampled = to_render(views, sequences), _counted(views, sequences)

    def there() -> list[Measured]:
        return [structs.replace(known[view], sampled=view in sampled) for view in wanted if view in known]

    result.images = there()
    result.flicker = []
    for view in wanted:
        if view not in known:
            known[view] = _measure(method, capture, view, pictures)
            result.images = there()
            done()
    result.flicker = [measure_flicker(capture, sequence, pictures) for sequence in sequences]


def _measure(method: Renderer, capture: Capture, view: View, pictures: Path) -> Measured:
    camera = capture.cameras[view.camera]
    start = time.perf_counter()
    image = method.render(camera, view.frame)
    seconds = time.perf_counter() - start
    mask = metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])
    figures = metrics.measure(capture.image(view.camera, view.frame), image, mask)
    with files.replacing(pictures / view.file) as beside:
        Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(beside)
    return Measured(view, seconds, figures)
