"""What a picture will take and how far it will be from convergence, as functions of its view, samples and early termination.

    t = c₀ + spp · (c₁·tiles + c₂·lanes + c₃·evaluated + c₄·launched)

The counts are those of :class:`ndf_mi.render.image.Work`, which no machine enters; :mod:`ndf_mi.render.ray_statistics` finds them without
drawing the picture. The c are what a machine takes for each, never below zero. The error is interpolated over the logarithm of the samples;
of fewer than were measured it goes on along the line, of more it is at most that of the most that were measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from ndf_mi.render.ray_statistics import Sight
from ndf_mi.render.settings import Setting

_MILLION = 1e6


@dataclass(frozen=True)
class Sample:
    """One setting as it was measured on one size of picture, one ray a pixel: means over the views.

    Attributes:
        samples, cutoff: of the setting.
        tiles, lanes, evaluated, launched: counts, as in :class:`ndf_mi.render.image.Work`.
        seconds: a picture.
        error: mean squared error in sRGB against convergence; None where it was not measured.
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
    """Fitted to samples, of which some have errors: at least one for each cutoff that may be asked for."""

    def __init__(self, samples: Sequence[Sample]) -> None:
        self.cutoffs = sorted({s.cutoff for s in samples if s.error is not None})
        rows = np.array([_row(s.tiles, s.lanes, s.evaluated, s.launched) for s in samples])
        seconds = np.array([s.seconds for s in samples])
        # Each row over its time: what is to be small is the error relative to it.
        self.coefficients, _ = nnls(rows / seconds[:, None], np.ones(len(samples)))
        self.residuals = rows @ self.coefficients / seconds - 1
        self._errors = {c: _errors([s for s in samples if s.cutoff == c]) for c in self.cutoffs}

    def seconds(self, setting: Setting, sight: Sight) -> float:
        """What a picture of this view is believed to take."""
        counts = sight.counts(setting)
        each = _row(counts.tiles, counts.lanes, counts.evaluated, counts.launched)
        return float(self.coefficients[0] + setting.spp * self.coefficients[1:] @ each[1:])

    def error(self, setting: Setting) -> float:
        """The mean squared error in sRGB against convergence that is believed in; where :meth:`beyond`, a bound from above."""
        log, errors = self._errors[setting.cutoff]
        x = math.log(setting.samples)
        if len(log) > 1 and x < log[0]:
            return float(math.exp(errors[0] + (errors[1] - errors[0]) / (log[1] - log[0]) * (x - log[0])))
        return float(math.exp(np.interp(x, log, errors)))

    def beyond(self, setting: Setting) -> bool:
        """Whether it has more samples than any whose error was measured. Not followed further by a line: what pictures are held against has
        errors of its own."""
        return bool(math.log(setting.samples) > self._errors[setting.cutoff][0][-1] + 1e-9)


def _row(tiles: float, lanes: float, evaluated: float, launched: float) -> np.ndarray:
    return np.array([1.0, tiles, lanes / _MILLION, evaluated / _MILLION, launched / _MILLION])


def _errors(samples: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of sample counts and of the mean errors there; more samples never count as worse."""
    counts = sorted({s.samples for s in samples if s.error is not None})
    known = [float(np.mean([s.error for s in samples if s.samples == n and s.error is not None])) for n in counts]
    # Without an error at all the logarithm would be infinite: a millionth of an 8-bit step squared is none.
    return np.log(counts), np.log(np.minimum.accumulate(np.maximum(known, 1e-12)))
