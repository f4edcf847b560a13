"""Pictures of a report: PNGs as data URIs with their alternative texts, error maps, and rows of them: the
truth, each method, and error maps on one scale.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.flicker import read_picture
from ndf_mi.experiments.records import SPLITS, Results, View
from ndf_mi.reports import tables

COLOUR_MAP = "magma"
#: Pixels kept around the body's box.
MARGIN = 2
#: Error maps stand right of pictures of at most this aspect, width over height, if there are at most `FEW`.
NARROW = 0.8
FEW = 4
#: How many views of a split are shown; one of the splits that are not listed.
VIEWS: Mapping[str, int] = {"novel_view": 4, "novel_pose": 4}


@dataclass(frozen=True)
class Picture:
    """One picture of a report.

    Attributes:
        source: a data URI.
        alt: what is seen, with its figures, for those who cannot see it.
        label: its name, printed below.
        caption: what is printed after the name.
    """

    source: str
    alt: str
    label: str = ""
    caption: str = ""


@dataclass(frozen=True)
class PictureRow:
    """Panels from left to right, and the pictures of each from top to bottom; the title may be empty."""

    panels: tuple[tuple[Picture, ...], ...]
    title: str = ""

    @property
    def height(self) -> int:
        """Pictures in the highest panel."""
        return max((len(panel) for panel in self.panels), default=0)


@dataclass(frozen=True)
class Shot:
    """What a row shows of one method: an image (h, w, 3), sRGB in [0, 1], and an error (h, w) or None."""

    label: str
    image: np.ndarray
    caption: str
    error: np.ndarray | None = None


def view_row(shots: Sequence[Shot], view: View, top: float = 1.0, reference: str = "the truth") -> PictureRow:
    """A row of pictures of one view, with an error map for each shot that has an error.

    Args:
        shots: from left to right, cut to the same size.
        view: what all of them show.
        top: the error that the upper end of the colour scale stands for.
        reference: what the errors refer to.
    """
    where = f"camera {view.camera}, frame {view.frame}"
    panels: list[tuple[Picture, ...]] = []
    for shot in shots:
        alt = f"{shot.label}: " + (shot.caption if where in shot.caption else f"{where}; {shot.caption}")
        panel: tuple[Picture, ...] = (picture(shot.image, alt, shot.label, shot.caption),)
        if shot.error is not None:
            caption = f"mean {shot.error.mean():.3f}, scale 0 to {top:g}"
            alt = f"Error map of {shot.label} against {reference}: {where}; {caption}"
            panel += (picture(error_map(shot.error, top), alt, f"Error: {shot.label}", caption),)
        panels.append(panel)
    height, width = shots[0].image.shape[:2]
    if width <= NARROW * height and len(shots) <= FEW:
        images, errors = ([panel[at : at + 1] for panel in panels if panel[at:]] for at in (0, 1))
        panels = images + errors
    return PictureRow(tuple(panels))


def picture(image: np.ndarray, alt: str, label: str = "", caption: str = "") -> Picture:
    """A picture of an image (h, w, 3): uint8, or float in [0, 1]."""
    pixels = image if image.dtype == np.uint8 else np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="png", optimize=True)
    source = "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
    return Picture(source, alt, label, caption)


def body_window(capture: Capture, view: View, shape: tuple[int, ...] | None = None) -> tuple[slice, slice]:
    """`mask_window` of `box_mask`."""
    return mask_window(box_mask(capture, view, shape))


def box_mask(capture: Capture, view: View, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """(h, w) bool: the pixels of a view, of the size `shape` if given, that see the body's padded box."""
    camera = capture.cameras[view.camera]
    camera = camera if shape is None else camera.scaled(shape[1], shape[0])
    return metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])


def mask_window(mask: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns that hold `mask` (h, w) with a small margin; all of them where it is empty."""
    rectangle = metrics.bounding_rectangle(mask)
    if rectangle is None:
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    rows, columns = (slice(max(side.start - MARGIN, 0), side.stop + MARGIN) for side in rectangle)
    return rows, columns


def absolute_error(truth: np.ndarray, image: np.ndarray) -> np.ndarray:
    """(h, w) float: |truth − image| in sRGB, averaged over the channels."""
    return np.asarray(np.abs(truth.astype(np.float64) - image).mean(axis=-1))


def error_scale(errors: Sequence[np.ndarray]) -> float:
    """A round upper end for a scale that error maps share: 99 % of the pixels with an error are below it."""
    values = np.concatenate([error.ravel() for error in errors]) if errors else np.zeros(1)
    values = values[values > 1 / 255]
    top = float(np.quantile(values, 0.99)) if values.size else 0.0
    return next((end for end in (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.75) if top <= end), 1.0)


def error_map(error: np.ndarray, top: float) -> np.ndarray:
    """(h, w, 3) uint8: errors from 0 to `top` as colours."""
    return np.asarray(matplotlib.colormaps[COLOUR_MAP](np.clip(error / top, 0, 1), bytes=True)[..., :3])


def gradient() -> str:
    """The colour map as a CSS gradient from low to high."""
    stops = (matplotlib.colors.to_hex(matplotlib.colormaps[COLOUR_MAP](step / 8)) for step in range(9))
    return f"linear-gradient(to right, {', '.join(stops)})"


@dataclass(frozen=True)
class Rows:
    """Rows of pictures by split, under the split's name, and the upper end of the error maps' scale."""

    splits: dict[str, list[PictureRow]]
    top: float


def picture_rows(results: Results, capture: Capture, pictures: Path) -> Rows:
    """Up to `VIEWS` views of each split, with error maps that share one scale; arguments as of
    `reports.compare.write_report`.
    """
    views = {split: spread(results, split, VIEWS.get(split, 1)) for split in results.splits()}
    shots = {view: _shots(results, capture, pictures, view) for chosen in views.values() for view in chosen}
    top = error_scale([shot.error for row in shots.values() for shot in row if shot.error is not None])
    rows = {split: [view_row(shots[view], view, top) for view in chosen] for split, chosen in views.items()}
    return Rows({SPLITS[split].capitalize(): found for split, found in rows.items()}, top)


def spread(results: Results, split: str, count: int, inner: bool = False) -> list[View]:
    """Views spread evenly over those of a split that count in its means and that every method has, by frame.

    Args:
        count: how many at most.
        inner: leave the first and the last view out where others remain.
    """
    views = [
        image.view
        for image in results.methods[0].images
        if image.sampled
        and image.view.split == split
        and all(method.find(image.view) is not None for method in results.methods)
    ]
    views.sort(key=lambda view: (view.frame, view.camera))
    if not views:
        return []
    picks = np.linspace(0, len(views) - 1, count + 2 if inner else min(count, len(views)))
    indices = picks.round().astype(int).tolist()
    return [views[i] for i in dict.fromkeys(indices[1:-1] if inner else indices)]


def truth_shot(capture: Capture, view: View) -> Shot:
    """The truth of a view, cut to the body."""
    image = capture.image(view.camera, view.frame)[body_window(capture, view)]
    return Shot("Truth", image, f"camera {view.camera}, frame {view.frame}")


def method_shots(results: Results, capture: Capture, pictures: Path, view: View) -> list[Shot]:
    """Each method's picture of a view, cut to the body, without errors."""
    window = body_window(capture, view)
    shots = []
    for method in results.methods:
        measured = method.find(view)
        psnr = tables.figure("box_psnr", measured.figures["box_psnr"] if measured else None)
        shots.append(Shot(method.label, read_picture(pictures / method.key, view)[window], f"{psnr} dB"))
    return shots


def _shots(results: Results, capture: Capture, pictures: Path, view: View) -> list[Shot]:
    truth = truth_shot(capture, view)
    shots = method_shots(results, capture, pictures, view)
    return [truth, *(replace(shot, error=absolute_error(truth.image, shot.image)) for shot in shots)]
