"""The report's rows of pictures: the truth, each method, and error maps on one scale."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import LABELS as SPLIT_LABELS
from ndf_mi.experiments.flicker import read_picture
from ndf_mi.experiments.records import Results, View
from ndf_mi.reports import tables
from ndf_mi.reports.pictures import absolute_error, data_uri, error_map, error_scale, gradient

ROWS = {"novel_view": 4, "novel_pose": 4, "sequence": 1, "train": 1}
#: Pixels kept around the body's box.
_MARGIN = 2
#: Width over height up to which a picture leaves room for the error maps beside it, and methods up to which it does.
_NARROW = 0.8
_FEW = 3


@dataclass(frozen=True)
class _Shown:
    """One view cut to the body: truth, then an image and an error for each method."""

    view: View
    truth: np.ndarray
    images: tuple[np.ndarray, ...]
    errors: tuple[np.ndarray, ...]


def pictures_section(results: Results, capture: Capture, pictures: Path) -> str:
    """HTML of up to `ROWS` views a split; the error maps of all of them share one labelled scale."""
    chosen = {split: _chosen(results, split) for split in results.splits()}
    shown = {split: [_load(results, capture, pictures, view) for view in views] for split, views in chosen.items()}
    top = error_scale([error for views in shown.values() for view in views for error in view.errors])
    parts = ["<h2>Pictures</h2>", scale_bar("Error maps: mean |difference| of the sRGB channels", top)]
    for split, views in shown.items():
        parts.append(f"<h3>{SPLIT_LABELS[split].capitalize()}</h3>")
        parts += [_row(results, view, top) for view in views]
    return "\n".join(parts)


def _chosen(results: Results, split: str) -> list[View]:
    """Views spread evenly over the split's images."""
    views = [image.view for image in results.methods[0].images if image.sampled and image.view.split == split]
    views.sort(key=lambda view: (view.frame, view.camera))
    count = min(ROWS[split], len(views))
    return [views[i] for i in np.linspace(0, len(views) - 1, count).round().astype(int)] if count else []


def _load(results: Results, capture: Capture, pictures: Path, view: View) -> _Shown:
    camera = capture.cameras[view.camera]
    mask = metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])
    window = cut(mask)
    truth = capture.image(view.camera, view.frame)[window]
    images = [read_picture(pictures / method.key, view)[window] for method in results.methods]
    return _Shown(view, truth, tuple(images), tuple(absolute_error(truth, image) for image in images))


def cut(mask: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns that hold `mask` (h, w) with a small margin; everything where it is empty."""
    rectangle = metrics.bounding_rectangle(mask)
    rows, columns = rectangle if rectangle is not None else (slice(0, mask.shape[0]), slice(0, mask.shape[1]))
    return (
        slice(max(rows.start - _MARGIN, 0), rows.stop + _MARGIN),
        slice(max(columns.start - _MARGIN, 0), columns.stop + _MARGIN),
    )


def _row(results: Results, shown: _Shown, top: float) -> str:
    """Truth and images beside each other; the error maps to their right if the pictures are narrow, else below."""
    view = shown.view
    height, width = shown.truth.shape[:2]
    narrow = width <= _NARROW * height and len(results.methods) <= _FEW
    labels = [method.label for method in results.methods]
    images = [figure(data_uri(shown.truth), "truth", f"camera {view.camera}, frame {view.frame}")]
    for method, image in zip(results.methods, shown.images, strict=True):
        measured = method.find(view)
        text = tables.figure("box_psnr", measured.figures["box_psnr"]) if measured else "–"
        images.append(figure(data_uri(image), method.label, f"{text} dB"))
    errors = [
        figure(data_uri(error_map(error, top)), f"error of {tables.lower(label)}", f"mean {error.mean():.3f}")
        for label, error in zip(labels, shown.errors, strict=True)
    ]
    heads = [head(text) for text in ("Truth", *labels)]
    error_heads = [head(f"Error of {tables.lower(text)}") for text in labels]
    if narrow:
        cells = heads + error_heads + images + errors
        return _grid(len(images) + len(errors), cells)
    return _grid(len(images), heads + images + [head("")] + error_heads + ["<div></div>"] + errors)


def _grid(columns: int, cells: list[str]) -> str:
    return f'<div class="row" style="grid-template-columns: repeat({columns}, 1fr)">{"".join(cells)}</div>'


def head(text: str) -> str:
    """A heading of a column, or row, of pictures."""
    return f'<div class="head">{escape(text)}</div>'


def figure(source: str, description: str, caption: str) -> str:
    """A picture, what it shows for those who can't see it, and what is written below it."""
    text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><img src="{source}" alt="{escape(description)}">{text}</figure>'


def scale_bar(text: str, top: float) -> str:
    """The colour scale of error maps, 0 … `top`, and what they show."""
    return (
        f'<div class="scale"><span>{escape(text)}</span><span>0</span>'
        f'<span class="bar" style="background: {gradient()}"></span><span>{top:g} and above</span></div>'
    )
