"""The report's part on temporal consistency: its course over each sequence, and strips of where changes are wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS as SPLIT_LABELS
from ndf_mi.experiments.evaluate import SPLITS
from ndf_mi.experiments.flicker import read_picture
from ndf_mi.experiments.records import Flicker, FrameSequence, Results
from ndf_mi.reports import tables
from ndf_mi.reports.picture_rows import cut, figure, head, scale_bar
from ndf_mi.reports.pictures import absolute_error, data_uri, error_map, error_scale, line_chart

#: Pairs of frames in a strip.
PAIRS = 5
#: Millimetres that the body moves from frame to frame, above which changes are of motion first: what walking is at 30 frames a second.
SMOOTH = 50
NOTE = (
    "Temporal PSNR is the PSNR of the change from one frame to the next, in one camera, over the boxes of both: an error that stays "
    "counts nothing, one that comes and goes does, and so does standing still while the performer moves. Errors that are independent "
    "from frame to frame put it 3 dB below box PSNR. It is measured on the sequences below alone."
)


@dataclass(frozen=True)
class _Strip:
    """Pairs of one sequence, cut to the body: |change| of the truth, and each method's error of it, (h, w) each."""

    pairs: tuple[int, ...]
    truth: tuple[np.ndarray, ...]
    errors: tuple[tuple[np.ndarray, ...], ...]


def flicker_section(results: Results, capture: Capture, pictures: Path) -> str:
    """HTML of a chart and a strip a sequence, strips on one labelled scale; empty if no sequence was measured."""
    known = sorted(results.methods[0].flicker, key=lambda flicker: SPLITS.index(flicker.sequence.split))
    if not known:
        return ""
    strips = [_load(results, capture, pictures, flicker.sequence) for flicker in known]
    top = error_scale([e for strip in strips for row in (strip.truth, *strip.errors) for e in row])
    parts = ["<h2>Temporal consistency</h2>", f'<p class="soft">{escape(NOTE)}</p>', _charts(results, known)]
    parts.append(scale_bar("Strips: mean |change| and |error of the change| of the sRGB channels", top))
    for flicker, strip in zip(known, strips, strict=True):
        parts.append(f"<h3>{SPLIT_LABELS[flicker.sequence.split].capitalize()}</h3>")
        parts.append(f'<p class="soft">{escape(_describe(flicker, capture))}</p>')
        parts.append(_strip(results, flicker, strip, top))
    return "\n".join(parts)


def _charts(results: Results, known: list[Flicker]) -> str:
    charts = []
    for reference in known:
        sequence = reference.sequence
        x = sequence.frames[1:]
        found = ((method.label, _of(method.flicker, sequence)) for method in results.methods)
        series = [(label, x, _finite(flicker.tpsnr)) for label, flicker in found if flicker is not None]
        title = f"{SPLIT_LABELS[sequence.split].capitalize()}: temporal PSNR"
        charts.append(line_chart(series, "frame", "dB", title, ("no change at all", x, _finite(reference.frozen))))
    return f'<div class="charts">{"".join(charts)}</div>'


def _describe(flicker: Flicker, capture: Capture) -> str:
    sequence = flicker.sequence
    rows = [capture.poses.index(frame) for frame in sequence.frames]
    moved = 1000 * float(np.median(np.linalg.norm(np.diff(capture.poses.vertices[rows], axis=0), axis=-1)))
    still = tables.figure(metrics.TEMPORAL, metrics.average(flicker.frozen))
    text = (
        f"Camera {sequence.camera}, {len(sequence.frames)} frames from {sequence.frames[0]} to {sequence.frames[-1]}, from one to the next "
        f"of which the body moves {moved:.0f} mm in the median. A picture that stood still would have {still} dB."
    )
    if moved > SMOOTH:
        text += " Frames that far apart say more of motion than of flicker."
    return text


def _load(results: Results, capture: Capture, pictures: Path, sequence: FrameSequence) -> _Strip:
    camera, views = capture.cameras[sequence.camera], sequence.views
    count = min(PAIRS, len(views) - 1)
    pairs = tuple(int(i) for i in np.linspace(0, len(views) - 2, count).round())
    frames = sorted({t + step for t in pairs for step in (0, 1)})
    union = np.zeros((camera.h, camera.w), bool)
    for t in frames:
        union |= metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(views[t].frame)])
    window = cut(union)
    truth = {t: capture.image(sequence.camera, views[t].frame)[window] for t in frames}
    still = np.zeros_like(truth[frames[0]])
    errors = []
    for method in results.methods:
        image = {t: read_picture(pictures / method.key, views[t])[window] for t in frames}
        errors.append(tuple(absolute_error(truth[t + 1] - truth[t], image[t + 1] - image[t]) for t in pairs))
    return _Strip(pairs, tuple(absolute_error(truth[t + 1] - truth[t], still) for t in pairs), tuple(errors))


def _strip(results: Results, reference: Flicker, strip: _Strip, top: float) -> str:
    """A row of what changes in truth, and one of each method's error; a column a pair of frames."""
    frames = reference.sequence.frames
    cells = [head("")] + [head(f"{frames[t]} → {frames[t + 1]}") for t in strip.pairs]
    cells.append(head("Change of the truth"))
    cells += [figure(data_uri(error_map(change, top)), "change of the truth", "") for change in strip.truth]
    for method, errors in zip(results.methods, strip.errors, strict=True):
        flicker = _of(method.flicker, reference.sequence)
        cells.append(head(f"Error of {tables.lower(method.label)}"))
        for t, error in zip(strip.pairs, errors, strict=True):
            value = tables.figure(metrics.TEMPORAL, flicker.tpsnr[t]) if flicker is not None else "–"
            description = f"error of the change, {tables.lower(method.label)}"
            cells.append(figure(data_uri(error_map(error, top)), description, f"{value} dB"))
    return f'<div class="row strip" style="grid-template-columns: 8rem repeat({len(strip.pairs)}, 1fr)">{"".join(cells)}</div>'


def _of(known: list[Flicker], sequence: FrameSequence) -> Flicker | None:
    return next((flicker for flicker in known if flicker.sequence == sequence), None)


def _finite(values: list[float | None]) -> list[float]:
    """Values for a chart, which leaves a gap where one is not defined or infinite."""
    return [math.nan if value is None or math.isinf(value) else value for value in values]
