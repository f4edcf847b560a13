"""How far a training has come, in numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far a training has come.

    Attributes:
        step: steps taken.
        seconds: time spent on steps and on what precedes the first.
        error: smoothed mean squared error in sRGB of the rays drawn.
        box_error: the same over the rays drawn from the whole box; NaN without such rays, and through
            scattering.
        evaluated: samples that reached the networks in the last step.
        steps_refused: steps that were not taken because gradients or parameters would not have been finite.
        rate_factor: factor on the learning rates that refused steps have left.
        held_back_error: mean squared error in sRGB of the held-back rays when they were last rendered; NaN
            before that, and if none are held back.
        held_back_step: steps taken then.
        kept_step: steps after which that error was least: what is published. None before the first
            measurement, and if no rays are held back or those that were are now trained on: then the last
            parameters are published.
        kept_error: the error then, or NaN.
        released: whether rays that were held back are now trained on, from `held_back_step` on.
    """

    step: int
    seconds: float
    error: float
    box_error: float
    evaluated: int
    steps_refused: int = 0
    rate_factor: float = 1.0
    held_back_error: float = float("nan")
    held_back_step: int = 0
    kept_step: int | None = None
    kept_error: float = float("nan")
    released: bool = False

    @property
    def psnr(self) -> float:
        """−10·log10 of the error, in dB, over the rays drawn."""
        return -10 * math.log10(max(self.error, 1e-12))

    @property
    def box_psnr(self) -> float | None:
        """The same over the rays drawn from the whole box, in which pixels are as frequent as in an image."""
        return _psnr(self.box_error)

    @property
    def held_back_psnr(self) -> float | None:
        """The same over the held-back rays when they were last rendered."""
        return _psnr(self.held_back_error)

    @property
    def kept_psnr(self) -> float | None:
        """The same of the parameters that are published."""
        return _psnr(self.kept_error)


def _psnr(error: float) -> float | None:
    return -10 * math.log10(max(error, 1e-12)) if math.isfinite(error) else None
