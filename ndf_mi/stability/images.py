"""Images and masks at their extremes: all black, all white, alike; masks of one pixel."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ndf_mi.experiments.metrics import average, flip_map, from_json, measure, psnr, ssim, temporal_psnr, to_json
from ndf_mi.stability.case import Measured, case, error

SIZE = 12


def plain(value: float | np.floating) -> np.ndarray:
    """An image of one grey."""
    return np.full((SIZE, SIZE, 3), value, np.float32)


@case("PSNR, SSIM, FLIP and temporal PSNR of images all black, all white, or a hair apart", "differences of 0 and 1e-8 to 1", gradient=None,
      relative_to="the value in dB, or 1")
def metrics_of_plain_images() -> Iterator[Measured]:
    """In closed form; nothing is differentiated in metrics."""
    for first in (0.0, 0.5, 1.0):
        for difference in (0.0, *(10.0**k for k in range(-8, 1))):
            a = np.float32(first)
            b = np.float32(first - difference if first == 1 else first + difference)
            exact_a, exact_b = float(a), float(b)
            off = abs(exact_a - exact_b)
            worst = 0.0
            found = psnr(plain(a), plain(b))
            worst = max(worst, 0.0 if off == 0 and found == math.inf else error(found, -20 * math.log10(off), 10.0) if off else math.inf)
            for data_range in (1.0, 2.0):
                c = (0.01 * data_range) ** 2
                expected = (2 * exact_a * exact_b + c) / (exact_a**2 + exact_b**2 + c)
                worst = max(worst, error(ssim(plain(a), plain(b), data_range), expected))
            flip = flip_map(plain(a), plain(b))
            # No closed form, but bounds: 0 for equal images, else up to 1, and the same everywhere in plain ones.
            spread = float(flip.max() - flip.min())
            worst = max(worst, 0.0 if off == 0 and flip.max() == 0 or 0 <= flip.min() <= flip.max() <= 1 else math.inf, spread)
            change = temporal_psnr((plain(0.25), plain(a)), (plain(0.5), plain(b)), np.ones((SIZE, SIZE), bool))
            off = abs((exact_b - 0.5) - (exact_a - 0.25))
            worst = max(worst, error(change, -20 * math.log10(off), 10.0) if off else 0.0 if change == math.inf else math.inf)
            yield Measured(f"{first:g}, {difference:g} apart", worst)


@case("all metrics under a mask of one pixel, none, or all", "black, white, and noise", gradient=None)
def masks_of_one_pixel() -> Iterator[Measured]:
    """What one pixel defines is its own; what it does not define is None, in JSON and in means too."""
    rng = np.random.default_rng(9)
    noise = rng.random((SIZE, SIZE, 3)).astype(np.float32)
    for name, truth, image in (("black and white", plain(0), plain(1)), ("white twice", plain(1), plain(1)), ("noise", noise, noise[::-1])):
        for place in ((0, 0), (5, 7), (SIZE - 1, SIZE - 1)):
            mask = np.zeros((SIZE, SIZE), bool)
            mask[place] = True
            found = measure(truth, image, mask)
            square = np.mean((truth[place].astype(np.float64) - image[place].astype(np.float64)) ** 2)
            undefined = [found["box_ssim"], found["box_ssim_range2"]]
            worst = 0.0 if undefined == [None, None] and average(undefined) is None else math.inf
            if square == 0:
                worst = max(worst, 0.0 if from_json(to_json(found["box_psnr"])) == math.inf else math.inf)
            else:
                worst = max(worst, error(found["box_psnr"], -10 * math.log10(square), 10.0))
            yield Measured(f"{name} at {place}", max(worst, error(found["box_flip"], flip_map(truth, image)[place])))
        empty = measure(truth, image, np.zeros((SIZE, SIZE), bool))
        boxes = [value for key, value in empty.items() if key.startswith("box")]
        full = measure(truth, image, np.ones((SIZE, SIZE), bool))
        same = full["box_psnr"] == full["psnr"] and full["box_ssim"] == full["ssim"]
        yield Measured(f"{name}, no pixel and all", 0.0 if boxes == [None] * 4 and same else math.inf)
