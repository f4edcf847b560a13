"""Rendering methods on held-out views and poses, and measuring them against the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.compare import metrics
from ndf_mi.compare.methods.base import Method
from ndf_mi.compare.results import Measured, MethodResult, View
from ndf_mi.errors import InputError

SPLITS = ("novel_view", "novel_pose", "train")
LABELS = {"novel_view": "novel views", "novel_pose": "novel poses", "train": "training views"}
#: Training images that are measured, beside the held-out ones, to show how far a method follows what it has seen.
TRAINING_IMAGES = 4


def choose_views(capture: Capture, max_images: int, seed: int = 0) -> list[View]:
    """The images to measure: of each held-out split all or `max_images`, drawn at random; and a few training images.

    A larger `max_images` draws the same images and more, so that what was measured stays of use.

    Raises:
        InputError: the capture has neither novel views nor novel poses.
    """
    chosen: list[View] = []
    for index, split in enumerate(SPLITS):
        pairs = [View(split, camera, frame) for camera, frame in capture.splits[split]]
        count = min(max_images, TRAINING_IMAGES) if split == "train" else max_images
        order = np.random.default_rng([seed, index]).permutation(len(pairs))
        chosen += [pairs[i] for i in sorted(order[:count])]
    if not any(view.split != "train" for view in chosen):
        raise InputError(f"{capture.path}: splits", "no novel_view or novel_pose", "held-out images to compare on")
    return chosen


def evaluate(
    method: Method,
    result: MethodResult,
    capture: Capture,
    views: Sequence[View],
    pictures: Path,
    done: Callable[[], None],
) -> None:
    """Renders and measures what `result` lacks of `views`, and leaves exactly `views` in it, in their order.

    Args:
        method: what renders.
        result: where figures go, image by image.
        capture: the truth.
        views: what to render.
        pictures: folder for the pictures, as 8-bit PNG; figures are of the unrounded images.
        done: called after each new image.
    """
    known = {image.view: image for image in result.images if (pictures / image.view.file).is_file()}
    result.images = [known[view] for view in views if view in known]
    for view in views:
        if view not in known:
            known[view] = _measure(method, capture, view, pictures)
            result.images = [known[v] for v in views if v in known]
            done()


def _measure(method: Method, capture: Capture, view: View, pictures: Path) -> Measured:
    camera = capture.cameras[view.camera]
    start = time.perf_counter()
    image = method.render(camera, view.frame)
    seconds = time.perf_counter() - start
    mask = metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])
    figures = metrics.measure(capture.image(view.camera, view.frame), image, mask)
    with files.replacing(pictures / view.file) as beside:
        Image.fromarray(np.round(image * 255).astype(np.uint8)).save(beside)
    return Measured(view, seconds, figures)
