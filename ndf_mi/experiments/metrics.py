"""Image metrics as the papers on animatable neural bodies compute them.

Images are (h, w, 3) float arrays, sRGB in [0, 1]. "Box" figures look only at the pixels whose ray hits the body's
padded, axis-aligned 3D box: the background, which every method gets right, would otherwise inflate them.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter

from ndf_mi.body.box import BOX_PADDING, padded_box
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.pixels import box_pixels
from ndf_mi.optional import require

SSIM_WINDOW = 7
#: The key of temporal PSNR, which is of a sequence; all others are of an image.
TEMPORAL = "box_tpsnr"
LABELS = {
    "box_psnr": "Box PSNR (dB)",
    "box_ssim": "Box SSIM, data_range 1",
    "box_ssim_range2": "Box SSIM, data_range 2",
    "box_flip": "Box FLIP",
    TEMPORAL: "Box tPSNR (dB)",
    "psnr": "Whole-image PSNR (dB)",
    "ssim": "Whole-image SSIM, data_range 1",
}
IMAGE_METRICS = tuple(name for name in LABELS if name != TEMPORAL)
HIGHER_IS_BETTER = {name: name != "box_flip" for name in LABELS}


def box_mask(camera: Camera, vertices: np.ndarray, padding: float = BOX_PADDING) -> np.ndarray:
    """The pixels whose ray through the centre hits the box of `vertices` (V, 3), grown by `padding` metres.

    Returns (h, w) bool; distortion is left out. A box behind the camera is not hit; a camera inside the box hits it everywhere.
    """
    return box_pixels(camera, *padded_box(vertices, padding))


def bounding_rectangle(mask: np.ndarray) -> tuple[slice, slice] | None:
    """The smallest rectangle (rows, columns) that holds every True pixel; None where there is none."""
    if not mask.any():
        return None
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def psnr(truth: np.ndarray, image: np.ndarray, mask: np.ndarray | None = None) -> float:
    """−10·log10(MSE) in dB over the pixels of `mask` (all by default); infinite for identical images.

    Raises:
        ValueError: the shapes differ, or the mask is empty.
    """
    _same_shape(truth, image)
    difference = truth.astype(np.float64) - image.astype(np.float64)
    if mask is not None:
        difference = difference[mask]
    if difference.size == 0:
        raise ValueError("PSNR over an empty mask")
    error = float(np.mean(difference**2))
    return math.inf if error == 0 else -10 * math.log10(error)


def temporal_psnr(
    truth: tuple[np.ndarray, np.ndarray], images: tuple[np.ndarray, np.ndarray], mask: np.ndarray
) -> float:
    """PSNR in dB of the change from one frame to the next, over the pixels of `mask`; infinite for equal changes.

    −10·log10 of the mean of ((I₂ − I₁) − (G₂ − G₁))², for images I and truth G, two successive frames (h, w, 3) of one camera.

    Raises:
        ValueError: the shapes differ, or the mask is empty.
    """
    before, after = (np.asarray(side, dtype=np.float64) for side in truth)
    first, second = (np.asarray(side, dtype=np.float64) for side in images)
    return psnr(after - before, second - first, mask)


def ssim(truth: np.ndarray, image: np.ndarray, data_range: float = 1.0) -> float:
    """Mean structural similarity (Wang et al. 2004), per channel, with a 7×7 uniform window and the sample covariance.

    Windows that reach over the edge are left out of the mean; K1 = 0.01, K2 = 0.03.

    Raises:
        ValueError: the shapes differ, or the window does not fit into the image.
    """
    _same_shape(truth, image)
    if min(truth.shape[:2]) < SSIM_WINDOW:
        size = f"{truth.shape[0]}×{truth.shape[1]}"
        raise ValueError(f"SSIM needs at least {SSIM_WINDOW}×{SSIM_WINDOW} pixels, not {size}")
    a, b = truth.astype(np.float64), image.astype(np.float64)
    window = (SSIM_WINDOW, SSIM_WINDOW, 1)
    unbias = SSIM_WINDOW**2 / (SSIM_WINDOW**2 - 1)
    mean_a, mean_b = uniform_filter(a, window), uniform_filter(b, window)
    variance_a = unbias * (uniform_filter(a * a, window) - mean_a**2)
    variance_b = unbias * (uniform_filter(b * b, window) - mean_b**2)
    covariance = unbias * (uniform_filter(a * b, window) - mean_a * mean_b)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    similarity = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    similarity /= (mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2)
    edge = SSIM_WINDOW // 2
    return float(similarity[edge : a.shape[0] - edge, edge : a.shape[1] - edge].mean())


def box_ssim(truth: np.ndarray, image: np.ndarray, mask: np.ndarray, data_range: float = 1.0) -> float:
    """SSIM of the bounding rectangle of `mask` (h, w), with zeros outside the mask in both images.

    `data_range` 1 is right for [0, 1]. Figures published with 2 exist (scikit-image's old default for floats): these
    are higher.

    Raises:
        ValueError: the mask is empty, or its rectangle is smaller than the window.
    """
    rectangle = bounding_rectangle(mask)
    if rectangle is None:
        raise ValueError("SSIM over an empty mask")
    inside = mask[..., None]
    return ssim(np.where(inside, truth, 0)[rectangle], np.where(inside, image, 0)[rectangle], data_range)


def flip_map(truth: np.ndarray, image: np.ndarray) -> np.ndarray:
    """FLIP per pixel, (h, w) in [0, 1] where 0 is equal (Andersson et al. 2020, LDR, 67 pixels a degree)."""
    flip_evaluator = require("flip_evaluator", extra="report")
    _same_shape(truth, image)
    pair = [np.ascontiguousarray(np.clip(side, 0, 1), dtype=np.float32) for side in (truth, image)]
    error, _, _ = flip_evaluator.evaluate(*pair, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False)
    return np.asarray(error, dtype=np.float32)[..., 0]


def measure(truth: np.ndarray, image: np.ndarray, mask: np.ndarray) -> dict[str, float | None]:
    """All metrics of one image, by the keys of `IMAGE_METRICS`.

    `mask` (h, w) is the image's `box_mask`. FLIP is evaluated on the whole image and averaged over the mask's bounding
    rectangle. A figure that is not defined (the box is out of sight, or smaller than SSIM's window) is None.
    """
    rectangle = bounding_rectangle(mask)
    seen = rectangle is not None
    crop = truth[rectangle] if rectangle is not None else truth[:0]
    fits = min(crop.shape[:2]) >= SSIM_WINDOW
    whole_fits = min(truth.shape[:2]) >= SSIM_WINDOW
    return {
        "box_psnr": psnr(truth, image, mask) if seen else None,
        "box_ssim": box_ssim(truth, image, mask) if fits else None,
        "box_ssim_range2": box_ssim(truth, image, mask, data_range=2.0) if fits else None,
        "box_flip": float(flip_map(truth, image)[rectangle].mean()) if rectangle is not None else None,
        "psnr": psnr(truth, image),
        "ssim": ssim(truth, image) if whole_fits else None,
    }


def average(values: list[float | None]) -> float | None:
    """The mean of the defined values; None if there is none. One infinite PSNR makes the mean infinite."""
    defined = [value for value in values if value is not None]
    return sum(defined) / len(defined) if defined else None


def to_json(value: float | None) -> float | str | None:
    """A figure as strict JSON holds it: infinity becomes "inf"; `float` reads it back."""
    return "inf" if value == math.inf else value


def from_json(value: float | str | None) -> float | None:
    """The inverse of `to_json`."""
    return None if value is None else float(value)


def _same_shape(truth: np.ndarray, image: np.ndarray) -> None:
    if truth.shape != image.shape:
        raise ValueError(f"images of different shapes: truth {truth.shape}, image {image.shape}")
