"""Image metrics as the papers on animatable neural bodies compute them.

Images are (h, w, 3) float arrays, sRGB in [0, 1]. Box metrics use only the pixels whose ray hits the body's
padded, axis-aligned 3D box. Otherwise the background, which every method gets right, would inflate them.
"""

from __future__ import annotations

import math

import numpy as np
from skimage.metrics import structural_similarity

from ndf_mi.body.box import BOX_PADDING, padded_box
from ndf_mi.capture.camera import Camera, box_pixels
from ndf_mi.experiments import perceptual
from ndf_mi.optional import require

SSIM_WINDOW = 7
TEMPORAL = "box_tpsnr"
"""The key of temporal PSNR, which is defined for a sequence; all other metrics are defined for an image."""
MATCHED = "box_psnr_matched"
"""The key of box PSNR after the best affine map of colour for each image."""
LPIPS = "box_lpips"
"""The key of LPIPS, which only those have who installed it (`ndf_mi.experiments.perceptual`)."""
LABELS = {
    "box_psnr": "Box PSNR (dB)", MATCHED: "Box PSNR, colours matched (dB)",
    "box_ssim": "Box SSIM, data_range 1", "box_ssim_range2": "Box SSIM, data_range 2",
    "box_flip": "Box FLIP", LPIPS: "Box LPIPS", TEMPORAL: "Box tPSNR (dB)",
    "psnr": "Whole-image PSNR (dB)", "ssim": "Whole-image SSIM, data_range 1",
}
IMAGE_METRICS = tuple(name for name in LABELS if name != TEMPORAL)
HIGHER_IS_BETTER = {name: name not in ("box_flip", LPIPS) for name in LABELS}


def box_mask(camera: Camera, vertices: np.ndarray, padding: float = BOX_PADDING) -> np.ndarray:
    """The pixels whose ray through the centre hits the box of `vertices` (V, 3), padded by `padding` metres.

    Returns (h, w) bool and ignores lens distortion. A box behind the camera is not hit; from inside the box,
    every ray hits it.
    """
    return box_pixels(camera, *padded_box(vertices, padding))


def bounding_rectangle(mask: np.ndarray) -> tuple[slice, slice] | None:
    """The smallest rectangle (rows, columns) that contains all True pixels; None if there are none."""
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


def match_colours(truth: np.ndarray, image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The image after the affine map of colour that brings it closest to the truth over the pixels of `mask`.

    A (3, 3) and b (3,) minimise the sum of |A·c + b − t|² over these pixels, in sRGB; where several do, as
    for an image of one colour, the smallest. (h, w, 3) float64, not cut to [0, 1].

    Raises:
        ValueError: the shapes differ, or the mask is empty.
    """
    _same_shape(truth, image)
    if not mask.any():
        raise ValueError("colours matched over an empty mask")
    with_one = np.concatenate([image, np.ones((*image.shape[:2], 1))], axis=-1).astype(np.float64)
    affine = np.linalg.lstsq(with_one[mask], truth[mask].astype(np.float64), rcond=None)[0]
    return with_one @ affine


def temporal_psnr(
    truth: tuple[np.ndarray, np.ndarray], images: tuple[np.ndarray, np.ndarray], mask: np.ndarray
) -> float:
    """PSNR in dB of the change from one frame to the next, over the pixels of `mask`; infinite for equal
    changes.

    −10·log10 of the mean of ((I₂ − I₁) − (G₂ − G₁))², for (h, w, 3) images I and truth G of two frames.

    Raises:
        ValueError: the shapes differ, or the mask is empty.
    """
    before, after = (np.asarray(side, dtype=np.float64) for side in truth)
    first, second = (np.asarray(side, dtype=np.float64) for side in images)
    return psnr(after - before, second - first, mask)


def ssim(truth: np.ndarray, image: np.ndarray, data_range: float = 1.0) -> float:
    """Mean structural similarity (Wang et al. 2004) with 7×7 uniform windows and the sample covariance, K1 =
    0.01, K2 = 0.03.

    Each channel counts alike; windows that cross the image's border are left out of the mean. Computed by
    scikit-image.

    Raises:
        ValueError: the shapes differ, or the window does not fit into the image.
    """
    _same_shape(truth, image)
    if min(truth.shape[:2]) < SSIM_WINDOW:
        size = f"{truth.shape[0]}×{truth.shape[1]}"
        raise ValueError(f"SSIM needs at least {SSIM_WINDOW}×{SSIM_WINDOW} pixels, not {size}")
    pair = truth.astype(np.float64), image.astype(np.float64)
    how = {"win_size": SSIM_WINDOW, "channel_axis": 2, "use_sample_covariance": True}
    return float(structural_similarity(*pair, data_range=data_range, **how))


def box_ssim(truth: np.ndarray, image: np.ndarray, mask: np.ndarray, data_range: float = 1.0) -> float:
    """SSIM in the bounding rectangle of `mask` (h, w), with zeros outside the mask in both images.

    `data_range` 1 is right for images in [0, 1]. Some published figures use 2, scikit-image's former default
    for floats; these are higher.

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
    how = {"inputsRGB": True, "applyMagma": False, "computeMeanError": False}
    return np.asarray(flip_evaluator.evaluate(*pair, "LDR", **how)[0], dtype=np.float32)[..., 0]


def measure(truth: np.ndarray, image: np.ndarray, mask: np.ndarray) -> dict[str, float | None]:
    """All metrics of one image, by the keys of `IMAGE_METRICS`.

    `mask` (h, w) is the image's `box_mask`. FLIP is evaluated on the whole image and averaged over the mask's
    bounding rectangle. A metric is None where it is undefined: the box is out of sight, or smaller than
    SSIM's window; LPIPS also where it cannot be computed here.
    """
    found: dict[str, float | None] = dict.fromkeys(IMAGE_METRICS)
    found["psnr"] = psnr(truth, image)
    if min(truth.shape[:2]) >= SSIM_WINDOW:
        found["ssim"] = ssim(truth, image)
    rectangle = bounding_rectangle(mask)
    if rectangle is not None:
        found["box_psnr"] = psnr(truth, image, mask)
        found[MATCHED] = psnr(truth, match_colours(truth, image, mask), mask)
        found["box_flip"] = float(flip_map(truth, image)[rectangle].mean())
        if not perceptual.absence():
            inside = mask[..., None]
            found[LPIPS] = perceptual.lpips(np.where(inside, truth, 0)[rectangle],
                                            np.where(inside, image, 0)[rectangle])
        if min(mask[rectangle].shape) >= SSIM_WINDOW:
            found["box_ssim"] = box_ssim(truth, image, mask)
            found["box_ssim_range2"] = box_ssim(truth, image, mask, data_range=2.0)
    return found


def average(values: list[float | None]) -> float | None:
    """The mean of the defined values; None if there are none. One infinite PSNR makes the mean infinite."""
    defined = [value for value in values if value is not None]
    return sum(defined) / len(defined) if defined else None


def _same_shape(truth: np.ndarray, image: np.ndarray) -> None:
    if truth.shape != image.shape:
        raise ValueError(f"images of different shapes: truth {truth.shape}, image {image.shape}")
