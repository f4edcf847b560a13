"""How a cost grows: a power law plus a constant, fitted to measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

_EXPONENTS = np.round(np.arange(0.05, 3.0001, 0.01), 2)
_LEVEL = 1.15
"""A cost that grows by less than this factor over the whole range counts as constant."""


@dataclass(frozen=True)
class Growth:
    """y = fixed + factor·x^exponent.

    Attributes:
        x, y: the quantity that was raised, and the cost; positive.
        fixed, factor: not negative.
        exponent: from 0.05 to 3.
        residual: root mean square of the relative deviation of the measurements from the fit.
        slope: exponent of a pure power law fitted to the last decade of x.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    fixed: float
    factor: float
    exponent: float
    residual: float
    slope: float

    def at(self, x: np.ndarray) -> np.ndarray:
        """The fitted cost at `x`."""
        return self.fixed + self.factor * np.asarray(x, dtype=np.float64) ** self.exponent

    @property
    def level(self) -> bool:
        """Whether the cost is nearly constant."""
        return max(self.y) < _LEVEL * min(self.y)

    @property
    def end(self) -> float:
        """The slope between the last two points on logarithmic axes."""
        return math.log(self.y[-1] / self.y[-2]) / math.log(self.x[-1] / self.x[-2])

    @property
    def levels_off(self) -> bool:
        """Whether the curve ends much flatter than the fit, so that a power law does not describe it."""
        return not self.level and self.exponent > 0 and self.end < 0.5 * self._fitted_end

    @property
    def _fitted_end(self) -> float:
        a, b = self.at(np.asarray(self.x[-2:]))
        return math.log(b / a) / math.log(self.x[-1] / self.x[-2])

    def formula(self, digits: int = 2) -> str:
        """The fit as a short formula."""
        if self.level:
            return f"about {np.median(self.y):.{digits}g}"
        power = f"∝ x^{self.exponent:.2f}"
        return power if self.fixed < 0.01 * min(self.y) else f"{self.fixed:.{digits}g} + {power}"

    def sentence(self, cost: str, raised: str, unit: str) -> str:
        """The curve in one sentence: “Time grows with the power 1.02 of the rays above a fixed 0.08 s …”."""
        reach = f"{min(self.x):,g} to {max(self.x):,g} {raised}"
        if self.level:
            spread = max(self.y) / min(self.y)
            median = f"{np.median(self.y):.3g} {unit}"
            return f"{cost} hardly changes from {reach}: {median}, within a factor of {spread:.2f}."
        fixed = "" if self.fixed < 0.01 * min(self.y) else f" above a fixed {self.fixed:.2g} {unit}"
        details = (
            f"rms deviation {100 * self.residual:.0f} %; {self.y[0]:.3g} to {self.y[-1]:.3g} {unit}; "
            f"slope {self.slope:.2f} over the last decade"
        )
        if self.levels_off:
            return (
                f"{cost} levels off from {reach}: the fitted power {self.exponent:.2f}{fixed} overstates its "
                f"end, where the last two points have slope {self.end:.2f} ({details})."
            )
        power = f"the power {self.exponent:.2f} of the {raised}{fixed}"
        return f"{cost} grows with {power}, from {reach} ({details})."


def fit_growth(x: Sequence[float], y: Sequence[float]) -> Growth:
    """Fits by least squares of the relative deviation. For each exponent the other two parameters are a
    linear problem.

    Args:
        x: three or more values above 0, rising.
        y: as many values above 0.

    Raises:
        ValueError: x or y is not as described.
    """
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if (
        a.ndim != 1
        or a.shape != b.shape
        or len(a) < 3
        or not (a > 0).all()
        or not (b > 0).all()
        or not (np.diff(a) > 0).all()
    ):
        raise ValueError("growth needs three or more rising values above 0, and as many costs above 0")
    scaled = a / a[-1]
    best: tuple[float, float, float, float] | None = None
    for exponent in _EXPONENTS:
        (fixed, factor), distance = nnls(np.stack([1 / b, scaled**exponent / b], axis=1), np.ones(len(b)))
        if best is None or distance < best[0]:
            best = distance, fixed, factor, float(exponent)
    assert best is not None
    distance, fixed, factor, exponent = best
    last = a >= a[-1] / 10 * (1 - 1e-9)
    slope = float(np.polyfit(np.log(a[last]), np.log(b[last]), 1)[0]) if last.sum() > 1 else float("nan")
    return Growth(
        tuple(a.tolist()), tuple(b.tolist()), fixed, factor / a[-1] ** exponent, exponent,
        distance / len(b) ** 0.5, slope,
    )
