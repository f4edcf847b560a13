"""A case of the stability suite: what a test computes and how large its errors may be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pytest

MARK = "stability"
PROPERTY = "stability"
"""Name of the mark that holds a test's :class:`Case`, and of the property that its reports hold points in."""

TOLERANCE = 1e-5
"""Relative error that is tolerated where a case does not justify another."""

LEAST = 16 * float(np.finfo(np.float32).tiny)
"""Smaller differences count as none. Kernels flush numbers below the least normal float, 1.2e-38, to zero; a
few of those may be added."""


@dataclass(frozen=True)
class Case:
    """What is computed, and the tolerances of its errors.

    Attributes:
        what: what is computed.
        over: the range of inputs.
        primal, gradient: tolerated relative errors; `gradient` None where nothing is differentiated.
        relative_to: what errors are relative to, if not the value itself. Where the tolerance is zero: what
            an error would mean.
    """

    what: str
    over: str
    primal: float = TOLERANCE
    gradient: float | None = TOLERANCE
    relative_to: str = ""


def case(what: str, over: str, **tolerances: Any) -> pytest.MarkDecorator:
    """Marks a test as a case; the arguments are those of :class:`Case`."""
    return getattr(pytest.mark, MARK)(Case(what, over, **tolerances))


@dataclass(frozen=True)
class Point:
    """The errors at one point of a case's range.

    Attributes:
        at: where in the range.
        primal, gradient: largest relative errors, infinite where something is not finite; `gradient` None
            where nothing is differentiated.
    """

    at: str
    primal: float
    gradient: float | None = None

    def within(self, case: Case) -> bool:
        """Whether both errors are finite and within the case's tolerances."""
        return self.primal <= case.primal and (
            self.gradient is None or self.gradient <= (case.gradient or 0.0))


class Check:
    """Compares the errors of a test with its case's tolerances; the fixture `check`.

    Args:
        case: the test's.
        record: pytest's `record_property`.
        at: where in the case's range the test is.
    """

    def __init__(self, case: Case, record: Callable[[str, object], None], at: str) -> None:
        self._case, self._record, self._at = case, record, at

    def __call__(self, primal: float, gradient: float | None = math.nan, at: str = "") -> None:
        """Records the errors at a point, and fails if one exceeds its tolerance or is not finite.

        Args:
            primal: largest relative error of the values.
            gradient: the same of the gradients. Omitted only in cases without gradients; None where this
                point has none.
            at: where in the range; by default, the test's parameters.
        """
        if self._case.gradient is None:
            assert gradient is not None and math.isnan(gradient), "a case without gradients"
            gradient = None
        point = Point(at or self._at, float(primal), None if gradient is None else float(gradient))
        self._record(PROPERTY, asdict(point))
        assert point.within(self._case), f"{point} exceeds the tolerances of {self._case}"


def error(found: Any, expected: Any, scale: Any = None) -> float:
    """The largest difference between two arrays, relative to `scale`, by default |`expected`|, entry by
    entry.

    Differences below :data:`LEAST` count as none; the result is infinite where an entry of `found` is not
    finite.

    Raises:
        ValueError: the shapes differ, or an expected value is not finite.
    """
    ours, reference = np.asarray(found, np.float64), np.asarray(expected, np.float64)
    if ours.shape != reference.shape:
        raise ValueError(f"an array of shape {ours.shape} for a reference of {reference.shape}")
    if not np.isfinite(reference).all():
        raise ValueError("a reference that is not finite")
    if not ours.size:
        return 0.0
    if not np.isfinite(ours).all():
        return math.inf
    size = np.broadcast_to(np.abs(reference) if scale is None else np.asarray(scale, np.float64), ours.shape)
    difference = np.maximum(np.abs(ours - reference) - LEAST, 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return float(np.where(difference > 0, difference / size, 0.0).max())


def decades(first: int, last: int, step: int = 1, signs: tuple[int, ...] = (1,)) -> list[float]:
    """Powers of ten, from 10^first to 10^last, each with every sign."""
    return [sign * 10.0**k for k in range(first, last + (1 if step > 0 else -1), step) for sign in signs]
