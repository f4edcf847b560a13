"""Predicts the time and the error of an image from its view, samples per ray and early termination.

    t = c₀ + spp · (c₁·tiles + c₂·lanes + c₃·evaluated + c₄·launched)

The counts are those of :class:`ndf_mi.render.image.Work`, which do not depend on the machine;
:mod:`ndf_mi.render.ray_statistics` estimates them without rendering the image. The coefficients c ≥ 0 are
fitted to measurements of one machine.

The error is interpolated linearly in log error over log samples. Below the fewest samples measured the line
is extended; above the most, their error is an upper bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from ndf_mi.render.image import Work
from ndf_mi.render.ray_statistics import RayStatistics
from ndf_mi.render.settings import Setting


@dataclass(frozen=True)
class Sample:
    """A measurement of one setting at one image size with one ray per pixel: means over the views.

    Attributes:
        samples, cutoff: of the setting.
        tiles, lanes, evaluated, launched: counts, as in :class:`ndf_mi.render.image.Work`.
        seconds: per image.
        error: mean squared error in sRGB against the converged image; None where it was not measured.
    """

    samples: int
    cutoff: float
    tiles: float
    lanes: float
    evaluated: float
    launched: float
    seconds: float
    error: float | None = None


class CostModel:
    """Time and error as functions of the setting.

    Args:
        samples: measurements. Errors can be predicted for the cutoffs at which at least one was measured.

    Attributes:
        cutoffs: those.
        coefficients: (5,) c.
        residuals: relative errors of the times, one for each of `samples`.
    """

    def __init__(self, samples: Sequence[Sample]) -> None:
        self.cutoffs = sorted({s.cutoff for s in samples if s.error is not None})
        rows = np.array([_row(s) for s in samples])
        seconds = np.array([s.seconds for s in samples])
        # Rows are divided by their times, so that relative errors are minimised.
        self.coefficients, _ = nnls(rows / seconds[:, None], np.ones(len(samples)))
        self.residuals = rows @ self.coefficients / seconds - 1
        self._errors = {c: _log_errors([s for s in samples if s.cutoff == c]) for c in self.cutoffs}

    def seconds(self, setting: Setting, statistics: RayStatistics) -> float:
        """Predicted time of an image of a view."""
        row = _row(statistics.counts(setting))
        return float(self.coefficients[0] + setting.spp * self.coefficients[1:] @ row[1:])

    def error(self, setting: Setting) -> float:
        """Predicted mean squared error in sRGB against the converged image; a bound where :meth:`beyond`."""
        log_samples, log_errors = self._errors[setting.cutoff]
        x = math.log(setting.samples)
        if len(log_samples) > 1 and x < log_samples[0]:
            slope = (log_errors[1] - log_errors[0]) / (log_samples[1] - log_samples[0])
            return float(math.exp(log_errors[0] + slope * (x - log_samples[0])))
        return float(math.exp(np.interp(x, log_samples, log_errors)))

    def beyond(self, setting: Setting) -> bool:
        """Whether the setting has more samples than any whose error was measured. The line is not extended
        there, because the converged image that errors are measured against has errors of its own."""
        return bool(math.log(setting.samples) > self._errors[setting.cutoff][0][-1] + 1e-9)


def _row(work: Sample | Work) -> np.ndarray:
    return np.array([1.0, work.tiles, work.lanes / 1e6, work.evaluated / 1e6, work.launched / 1e6])


def _log_errors(samples: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the sample counts and of the mean errors there; errors never rise with the samples."""
    counts = sorted({s.samples for s in samples if s.error is not None})
    errors = [
        float(np.mean([s.error for s in samples if s.samples == n and s.error is not None])) for n in counts]
    # The logarithm needs an error above zero; 1e-12 is far below an 8-bit step squared.
    return np.log(counts), np.log(np.minimum.accumulate(np.maximum(errors, 1e-12)))
