"""Temporal consistency: a chart of each sequence, and strips that show where changes are wrong."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.flicker import read_picture
from ndf_mi.experiments.records import SPLITS, Flicker, FrameSequence, MethodResult, Results, View
from ndf_mi.reports import charts, tables
from ndf_mi.reports.charts import Chart
from ndf_mi.reports.pictures import (
    PictureRow,
    absolute_error,
    box_mask,
    error_map,
    error_scale,
    mask_window,
    picture,
)

#: Pairs of frames in a strip.
PAIRS = 5
#: Motion between frames, in mm, above which changes show motion more than flicker: walking at 30 fps.
SMOOTH = 50


@dataclass(frozen=True)
class ShownSequence:
    """What is shown of one sequence."""

    title: str
    description: str
    strips: list[PictureRow]


@dataclass(frozen=True)
class Section:
    """Charts and sequences, whose strips share a scale from 0 to `top`."""

    charts: list[Chart]
    sequences: list[ShownSequence]
    top: float


def flicker_section(results: Results, capture: Capture, pictures: Path) -> Section | None:
    """A chart and strips for each sequence of the first method; None if none was measured. Arguments as of
    `reports.compare.write_report`.
    """
    known = sorted(results.methods[0].flicker, key=lambda flicker: list(SPLITS).index(flicker.sequence.split))
    if not known:
        return None
    changes = [_changes(results, capture, pictures, flicker.sequence) for flicker in known]
    top = error_scale([image for rows in changes for row in rows for image in row])
    sequences = []
    for flicker, rows in zip(known, changes, strict=True):
        title = SPLITS[flicker.sequence.split].capitalize()
        strips = _strips(results, flicker, rows, top)
        sequences.append(ShownSequence(title, _describe(flicker, capture), strips))
    return Section([_chart(results, flicker) for flicker in known], sequences, top)


def _chart(results: Results, reference: Flicker) -> Chart:
    x = reference.sequence.frames[1:]
    found = ((method.label, _of(method, reference.sequence)) for method in results.methods)
    series = [(label, x, _finite(flicker.tpsnr)) for label, flicker in found if flicker is not None]
    title = f"{SPLITS[reference.sequence.split].capitalize()}: temporal PSNR"
    still = ("a still picture", x, _finite(reference.frozen))
    return charts.line_chart(series, "frame", "temporal PSNR (dB)", title, still)


def _describe(flicker: Flicker, capture: Capture) -> str:
    frames = flicker.sequence.frames
    vertices = capture.poses.vertices[[capture.poses.index(frame) for frame in frames]]
    moved = 1000 * float(np.median(np.linalg.norm(np.diff(vertices, axis=0), axis=-1)))
    still = tables.figure(metrics.TEMPORAL, metrics.average(flicker.frozen))
    text = (
        f"Camera {flicker.sequence.camera}, {len(frames)} frames from {frames[0]} to {frames[-1]}. The "
        f"body’s vertices move {moved:.0f} mm between frames (median). A still picture reaches {still} dB."
    )
    if moved > SMOOTH:
        text += " Frames this far apart show motion more than flicker."
    return text


def _pairs(sequence: FrameSequence) -> list[int]:
    """The positions in a sequence of the first frames of the pairs that are shown."""
    last = len(sequence.frames) - 2
    return [int(i) for i in np.linspace(0, last, min(PAIRS, last + 1)).round()]


def _changes(
    results: Results, capture: Capture, pictures: Path, sequence: FrameSequence
) -> list[list[np.ndarray]]:
    """(h, w) changes of the truth, then errors of each method, for pairs of frames, cut to the body."""
    views, pairs = sequence.views, _pairs(sequence)
    frames = sorted({t + step for t in pairs for step in (0, 1)})
    window = mask_window(np.any([box_mask(capture, views[t]) for t in frames], axis=0))

    def changes(load: Callable[[View], np.ndarray]) -> list[np.ndarray]:
        images = {t: load(views[t])[window] for t in frames}
        return [images[t + 1] - images[t] for t in pairs]

    truth = changes(lambda view: capture.image(view.camera, view.frame))
    found = [changes(partial(read_picture, pictures / method.key)) for method in results.methods]
    still = [np.zeros_like(change) for change in truth]
    return [[absolute_error(a, b) for a, b in zip(truth, row, strict=True)] for row in (still, *found)]


def _strips(
    results: Results, reference: Flicker, changes: list[list[np.ndarray]], top: float
) -> list[PictureRow]:
    """The truth's changes, and each method's errors of them: a picture for each pair of frames."""
    frames, pairs = reference.sequence.frames, _pairs(reference.sequence)
    names = [f"{frames[t]} → {frames[t + 1]}" for t in pairs]

    def strip(title: str, images: Sequence[np.ndarray], captions: Sequence[str]) -> PictureRow:
        panels = []
        for image, name, caption in zip(images, names, captions, strict=True):
            alt = f"{title}, frames {name}: mean {image.mean():.3f}, scale 0 to {top:g}; {caption}"
            panels.append((picture(error_map(image, top), alt, name, caption),))
        return PictureRow(tuple(panels), title)

    truth, *errors = changes
    rows = [strip("Change of the truth", truth, [f"mean {change.mean():.3f}" for change in truth])]
    for method, images in zip(results.methods, errors, strict=True):
        flicker = _of(method, reference.sequence)
        values = [None if flicker is None else flicker.tpsnr[t] for t in pairs]
        captions = [f"{tables.figure(metrics.TEMPORAL, value)} dB" for value in values]
        rows.append(strip(f"Error of {tables.named(method.label)}", images, captions))
    return rows


def _of(method: MethodResult, sequence: FrameSequence) -> Flicker | None:
    return next((flicker for flicker in method.flicker if flicker.sequence == sequence), None)


def _finite(values: list[float | None]) -> list[float]:
    """Values for a chart, which leaves a gap where one is undefined or infinite."""
    return [math.nan if value is None or math.isinf(value) else value for value in values]
