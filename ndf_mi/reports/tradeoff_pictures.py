"""Pictures at the knees: what the ends and the knee of each front look like, beside truth and convergence."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image
from skimage.transform import resize

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS
from ndf_mi.experiments.records import View
from ndf_mi.experiments.trade.results import Row, Trade, reference_of
from ndf_mi.reports import pictures, tables

if TYPE_CHECKING:
    from ndf_mi.reports.tradeoff import Group

_PICTURES = "pictures"


def knees(groups: Sequence[Group], trade: Trade, capture: Capture, folder: Path) -> str:
    """A block a group, of its fastest point, its knee and its best: the picture, and below it the error that the group is about.

    Args:
        groups: the fronts.
        trade: what was measured.
        capture: the truth.
        folder: of the study, which holds the pictures.
    """
    parts = [f'<div class="scale"><span>error 0</span><span class="bar" style="background: {pictures.gradient()}"></span>'
             "<span>as noted under each, mean of the channels in sRGB</span></div>"]
    for group in groups:
        chosen = list(dict.fromkeys([group.front[0], *([group.knee] if group.knee is not None else []), group.front[-1]]))
        parts.append(f"<h3>{escape(group.title)}</h3>")
        parts += [_row(group, chosen, view, capture, folder) for view in _views(group.rows[chosen[0]])]
    return "\n".join(parts)


def _views(row: Row) -> list[View]:
    """One view of each split."""
    first: dict[str, View] = {}
    for figures in row.figures:
        first.setdefault(figures.view.split, figures.view)
    return list(first.values())


def _row(group: Group, chosen: Sequence[int], view: View, capture: Capture, folder: Path) -> str:
    rows = [group.rows[i] for i in chosen]
    by_truth = "truth" in group.quality
    images = [_read(folder / _PICTURES / row.key / view.file) for row in rows]
    # Fields differ from row to row where they were trained by the study: there the truth alone is common to all.
    common = _read(folder / _PICTURES / reference_of(rows[0].field, None if rows[0].by_paths else 1) / view.file)
    shape = images[0].shape
    truth = capture.image(view.camera, view.frame)
    truth = truth if truth.shape == shape else np.asarray(resize(truth, shape, order=1, anti_aliasing=True), dtype=np.float32)
    references = [truth if by_truth else _read(folder / _PICTURES / row.reference / view.file) for row in rows]
    errors = [pictures.absolute_error(a, b) for a, b in zip(references, images, strict=True)]
    top = pictures.error_scale(errors)
    box = _box(capture, view, shape)
    heads, above, below = [], [], []
    if by_truth:
        heads, above, below = ["Truth"], [_figure(truth[box], f"{LABELS[view.split]}, camera {view.camera}, frame {view.frame}")], [""]
    if not by_truth or len({row.field for row in rows}) == 1:
        heads.append("Converged")
        above.append(_figure(common[box], f"camera {view.camera}, frame {view.frame}"))
        below.append(_figure(pictures.error_map(pictures.absolute_error(truth, common)[box], top), f"0 to {top:g}") if by_truth else "")
    for index, row, image, error in zip(chosen, rows, images, errors, strict=True):
        name = "knee" if index == group.knee else "fastest" if index == group.front[0] else "best"
        heads.append(f"{name.capitalize()}: {row.label}")
        value = next(f for f in row.figures if f.view == view)
        decibel = value.truth.get("box_psnr") if by_truth else value.converged
        above.append(_figure(image[box], f"{tables.duration(row.frame_seconds)}, {tables.figure('psnr', decibel)} dB"))
        below.append(_figure(pictures.error_map(error[box], top), f"0 to {top:g}"))
    cells = "".join(f'<div class="head">{escape(text)}</div>' for text in heads) + "".join(above) + "".join(
        cell or "<div></div>" for cell in below)
    return f'<div class="row" style="grid-template-columns: repeat({len(heads)}, 1fr)">{cells}</div>'


def _box(capture: Capture, view: View, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The rectangle of the body's box on so many pixels."""
    camera = capture.cameras[view.camera].scaled(shape[1], shape[0])
    found = metrics.bounding_rectangle(metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)]))
    return found or (slice(None), slice(None))


def _read(file: Path) -> np.ndarray:
    with Image.open(file) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.float32) / 255


def _figure(image: np.ndarray, caption: str) -> str:
    return f'<figure><img src="{pictures.data_uri(image)}" alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
