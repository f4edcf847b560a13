"""Metrics of images and masks at their extremes: all black, all white, equal; masks of one pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ndf_mi.experiments import metrics
from ndf_mi.stability.case import Check, case, decades, error

SIZE = 12


def plain(value: float | np.floating) -> np.ndarray:
    """An image of one grey."""
    return np.full((SIZE, SIZE, 3), value, np.float32)


def psnr_error(found: float, difference: float) -> float:
    """Error of a PSNR, at least relative to 10 dB; images without a difference have an infinite one."""
    return (
        error(found, -20 * math.log10(difference), 10.0) if difference else 0.0 if found == math.inf
        else math.inf)


@case(
    "PSNR, SSIM, FLIP and temporal PSNR of images all black, all white, or a hair apart",
    "differences of 0 and 1e-8 to 1", gradient=None, relative_to="the value in dB, or 1")
@pytest.mark.parametrize("difference", [0.0, *decades(-8, 0)], ids="{:g} apart".format)
@pytest.mark.parametrize("first", [0.0, 0.5, 1.0], ids="{:g}".format)
def test_metrics_of_plain_images(check: Check, first: float, difference: float) -> None:
    """Closed forms; for FLIP, which has none, bounds, and that it is the same everywhere in plain images."""
    one, other = np.float32(first), np.float32(first - difference if first == 1 else first + difference)
    a, b = float(one), float(other)
    errors = [psnr_error(metrics.psnr(plain(one), plain(other)), abs(a - b))]
    for data_range in (1.0, 2.0):
        c = (0.01 * data_range) ** 2
        errors.append(
            error(metrics.ssim(plain(one), plain(other), data_range), (2 * a * b + c) / (a**2 + b**2 + c)))
    flip = metrics.flip_map(plain(one), plain(other))
    assert 0 <= flip.min() <= flip.max() <= 1 and (a != b or flip.max() == 0)
    errors.append(float(flip.max() - flip.min()))
    change = metrics.temporal_psnr(
        (plain(0.25), plain(one)), (plain(0.5), plain(other)), np.ones((SIZE, SIZE), bool))
    errors.append(psnr_error(change, abs((b - 0.5) - (a - 0.25))))
    check(max(errors))


NOISE = np.random.default_rng(9).random((SIZE, SIZE, 3)).astype(np.float32)
PAIRS = {
    "black and white": (plain(0), plain(1)), "white twice": (plain(1), plain(1)),
    "noise": (NOISE, NOISE[::-1])}


@case("all metrics under a mask of one pixel, none, or all", "black, white, and noise", gradient=None)
@pytest.mark.parametrize("pair", PAIRS)
def test_masks_of_one_pixel(check: Check, pair: str) -> None:
    """Metrics that one pixel defines are that pixel's; the others are None, in means too."""
    truth, image = PAIRS[pair]
    for place in ((0, 0), (5, 7), (SIZE - 1, SIZE - 1)):
        mask = np.zeros((SIZE, SIZE), bool)
        mask[place] = True
        found = metrics.measure(truth, image, mask)
        undefined = [found["box_ssim"], found["box_ssim_range2"]]
        assert undefined == [None, None] and metrics.average(undefined) is None
        square = np.mean((truth[place].astype(np.float64) - image[place].astype(np.float64)) ** 2)
        box_psnr = found["box_psnr"]
        assert box_psnr is not None
        check(
            max(
                psnr_error(box_psnr, math.sqrt(square)),
                error(found["box_flip"], metrics.flip_map(truth, image)[place])),
            at=f"{pair} at {place}",
        )
    empty = metrics.measure(truth, image, np.zeros((SIZE, SIZE), bool))
    assert {value for key, value in empty.items() if key.startswith("box")} == {None}
    full = metrics.measure(truth, image, np.ones((SIZE, SIZE), bool))
    assert full["box_psnr"] == full["psnr"] and full["box_ssim"] == full["ssim"]
