"""What a picture will take and how far it will be from convergence, as functions of its rays, samples and early termination.

    t = c₀ + spp · (c₁·tiles + c₂·lanes + c₃·evaluated)

The counts are those of :class:`ndf_mi.render.image.Work`, which no machine enters; the c are what a machine takes for each, never below
zero. How many candidates are looked at and evaluated, as a share of all, and the error, are interpolated over the logarithm of the samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from ndf_mi.compare.trade.setting import Setting

_MILLION = 1e6


@dataclass(frozen=True)
class Sample:
    """One setting as it was measured on one size of picture: sums over the views, and per view the time.

    Attributes:
        samples, cutoff: of the setting, one ray a pixel.
        rays, tiles, lanes, candidates, evaluated: of one view, on average over the views.
        seconds: of one view, on average over the views.
        error: mean squared error in sRGB against convergence; None where it was not measured.
    """

    samples: int
    cutoff: float
    rays: float
    tiles: float
    lanes: float
    candidates: float
    evaluated: float
    seconds: float
    error: float | None = None


@dataclass(frozen=True)
class Sight:
    """How a view differs from those measured.

    Attributes:
        rays: that meet the box.
        candidates, evaluated: factors on the shares that the views measured had.
    """

    rays: int
    candidates: float = 1.0
    evaluated: float = 1.0


class CostModel:
    """Fitted to samples, of which some have errors.

    Args:
        samples: at least one for each cutoff with an error.
        strata: the field's factor on candidate samples.
    """

    def __init__(self, samples: Sequence[Sample], strata: int) -> None:
        self._strata = strata
        self.cutoffs = sorted({s.cutoff for s in samples if s.error is not None})
        rows = np.array([[1.0, s.tiles, s.lanes / _MILLION, s.evaluated / _MILLION] for s in samples])
        seconds = np.array([s.seconds for s in samples])
        # Each row over its time: what is to be small is the error relative to it.
        self.coefficients, _ = nnls(rows / seconds[:, None], np.ones(len(samples)))
        self.residuals = rows @ self.coefficients / seconds - 1
        self._shares = {c: _shares([s for s in samples if s.cutoff == c], strata) for c in self.cutoffs}
        self._errors = {c: _errors([s for s in samples if s.cutoff == c]) for c in self.cutoffs}

    def seconds(self, setting: Setting, sight: Sight) -> float:
        """What a picture in this view is believed to take; the setting's cutoff is one of `cutoffs`."""
        looked, evaluated = self.shares(setting)
        looked, evaluated = min(looked * sight.candidates, 1.0), evaluated * sight.evaluated
        rounds, count, tile = setting.renderer().tiling(self._strata, sight.rays)
        # Of a view's rays all are in the first round, and what is left of them on average in the others.
        alive = sight.rays if rounds == 1 else sight.rays * max(looked * rounds - 1, 0) / (rounds - 1)
        tiles = math.ceil(sight.rays / tile) + (rounds - 1) * math.ceil(alive / tile)
        lanes = tiles * tile * count * self._strata / _MILLION
        each = np.array([tiles, lanes, evaluated * sight.rays * setting.samples * self._strata / _MILLION])
        return float(self.coefficients[0] + setting.spp * self.coefficients[1:] @ each)

    def shares(self, setting: Setting) -> tuple[float, float]:
        """The shares of all candidates that are looked at and that are evaluated, in the views measured."""
        log, looked, evaluated = self._shares[setting.cutoff]
        x = math.log(setting.samples)
        return float(np.interp(x, log, looked)), float(np.interp(x, log, evaluated))

    def error(self, setting: Setting) -> float:
        """The mean squared error in sRGB against convergence that is believed in."""
        log, errors = self._errors[setting.cutoff]
        x = math.log(setting.samples)
        if len(log) > 1 and not log[0] <= x <= log[-1]:
            # Beyond what was measured: on along the line of the two nearest.
            a, b = (0, 1) if x < log[0] else (-2, -1)
            return float(math.exp(errors[b] + (errors[b] - errors[a]) / (log[b] - log[a]) * (x - log[b])))
        return float(math.exp(np.interp(x, log, errors)))


def _shares(samples: Sequence[Sample], strata: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Logarithms of sample counts, and the shares there; where several sizes were measured at one count, their mean."""
    counts = sorted({s.samples for s in samples})
    looked, evaluated = (
        np.array([np.mean([getattr(s, key) / (s.rays * s.samples * strata) for s in samples if s.samples == n]) for n in counts])
        for key in ("candidates", "evaluated"))
    return np.log(counts), looked, evaluated


def _errors(samples: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of sample counts and of the mean errors there; more samples never count as worse."""
    counts = sorted({s.samples for s in samples if s.error is not None})
    known = [float(np.mean([s.error for s in samples if s.samples == n and s.error is not None])) for n in counts]
    # Without an error at all the logarithm would be infinite: a millionth of an 8-bit step squared is none.
    return np.log(counts), np.log(np.minimum.accumulate(np.maximum(known, 1e-12)))
