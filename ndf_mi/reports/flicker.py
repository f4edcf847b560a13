"""Temporal consistency: a chart of each sequence, and strips that show where changes are wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class _Changes:
    """(h, w) changes of the truth and errors of each method, for pairs of frames, cut to the body."""

    pairs: tuple[int, ...]
    truth: tuple[np.ndarray, ...]
    errors: tuple[tuple[np.ndarray, ...], ...]


def flicker_section(results: Results, capture: Capture, pictures: Path) -> Section | None:
    """A chart and strips for each sequence; None if none was measured.

    Args:
        results: what was measured; the sequences are those of the first method.
        capture: the truth.
        pictures: a folder for each method, by its key.
    """
    known = sorted(results.methods[0].flicker, key=lambda flicker: list(SPLITS).index(flicker.sequence.split))
    if not known:
        return None
    changes = [_load(results, capture, pictures, flicker.sequence) for flicker in known]
    top = error_scale([image for of in changes for row in (of.truth, *of.errors) for image in row])
    sequences = []
    for flicker, change in zip(known, changes, strict=True):
        title = SPLITS[flicker.sequence.split].capitalize()
        strips = _strips(results, flicker, change, top)
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


def _load(results: Results, capture: Capture, pictures: Path, sequence: FrameSequence) -> _Changes:
    views = sequence.views
    pairs = tuple(int(i) for i in np.linspace(0, len(views) - 2, min(PAIRS, len(views) - 1)).round())
    frames = sorted({t + step for t in pairs for step in (0, 1)})
    window = mask_window(np.any([box_mask(capture, views[t]) for t in frames], axis=0))

    def changes(method: MethodResult | None) -> list[np.ndarray]:
        images = {t: _image(capture, pictures, views[t], method)[window] for t in frames}
        return [images[t + 1] - images[t] for t in pairs]

    def compare(found: list[np.ndarray]) -> tuple[np.ndarray, ...]:
        return tuple(absolute_error(a, b) for a, b in zip(truth, found, strict=True))

    truth = changes(None)
    still = [np.zeros_like(change) for change in truth]
    return _Changes(pairs, compare(still), tuple(compare(changes(method)) for method in results.methods))


def _image(capture: Capture, pictures: Path, view: View, method: MethodResult | None) -> np.ndarray:
    if method is None:
        return capture.image(view.camera, view.frame)
    return read_picture(pictures / method.key, view)


def _strips(results: Results, reference: Flicker, changes: _Changes, top: float) -> list[PictureRow]:
    """The truth's changes, and each method's errors of them: a picture for each pair of frames."""
    frames = reference.sequence.frames
    names = [f"{frames[t]} → {frames[t + 1]}" for t in changes.pairs]

    def strip(title: str, images: Sequence[np.ndarray], captions: Sequence[str]) -> PictureRow:
        panels = []
        for image, name, caption in zip(images, names, captions, strict=True):
            alt = f"{title}, frames {name}: mean {image.mean():.3f}, scale 0 to {top:g}; {caption}"
            panels.append((picture(error_map(image, top), alt, name, caption),))
        return PictureRow(tuple(panels), title)

    means = [f"mean {change.mean():.3f}" for change in changes.truth]
    rows = [strip("Change of the truth", changes.truth, means)]
    for method, errors in zip(results.methods, changes.errors, strict=True):
        flicker = _of(method, reference.sequence)
        values = [None if flicker is None else flicker.tpsnr[t] for t in changes.pairs]
        captions = [f"{tables.figure(metrics.TEMPORAL, value)} dB" for value in values]
        rows.append(strip(f"Error of {tables.lower(method.label)}", errors, captions))
    return rows


def _of(method: MethodResult, sequence: FrameSequence) -> Flicker | None:
    return next((flicker for flicker in method.flicker if flicker.sequence == sequence), None)


def _finite(values: list[float | None]) -> list[float]:
    """Values for a chart, which leaves a gap where one is undefined or infinite."""
    return [math.nan if value is None or math.isinf(value) else value for value in values]
