"""Pictures of a report: PNGs as data URIs with their alternative texts, error maps, and rows of them."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from PIL import Image

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments import metrics
from ndf_mi.experiments.records import View

COLOUR_MAP = "magma"
#: Pixels kept around the body's box.
MARGIN = 2
#: Error maps stand right of pictures of at most this aspect, width over height, if there are at most `FEW`.
NARROW = 0.8
FEW = 4


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
    images: list[Picture] = []
    errors: list[tuple[Picture, ...]] = []
    for shot in shots:
        alt = f"{shot.label}: " + (shot.caption if where in shot.caption else f"{where}; {shot.caption}")
        images.append(picture(shot.image, alt, shot.label, shot.caption))
        errors.append(())
        if shot.error is not None:
            caption = f"mean {shot.error.mean():.3f}, scale 0 to {top:g}"
            alt = f"Error map of {shot.label} against {reference}: {where}; {caption}"
            errors[-1] = (picture(error_map(shot.error, top), alt, f"Error: {shot.label}", caption),)
    height, width = shots[0].image.shape[:2]
    if width <= NARROW * height and len(shots) <= FEW:
        return PictureRow((*((image,) for image in images), *filter(None, errors)))
    return PictureRow(tuple((image, *error) for image, error in zip(images, errors, strict=True)))


def picture(image: np.ndarray, alt: str, label: str = "", caption: str = "") -> Picture:
    """A picture of an image (h, w, 3): uint8, or float in [0, 1]."""
    pixels = image if image.dtype == np.uint8 else np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="png", optimize=True)
    source = "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
    return Picture(source, alt, label, caption)


def body_window(capture: Capture, view: View, shape: tuple[int, ...] | None = None) -> tuple[slice, slice]:
    """Rows and columns that hold the body's padded box, with a small margin; all where it is out of sight.

    Args:
        capture: the cameras and poses.
        view: which image.
        shape: (h, w, …) of the image, where it differs from the capture's.
    """
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
