"""What a case of the suite is: a function that measures errors against a float64 reference, and what is promised of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

PROMISE = 1e-5
"""Relative error that is promised where nothing else is argued for."""

LEAST = 16 * float(np.finfo(np.float32).tiny)
"""Differences below it count as none. Kernels take numbers under the least normal float, 1.2e-38, for zero; a few such may be added up."""


@dataclass(frozen=True)
class Measured:
    """The largest errors at one point of a case's range, infinite where something was not finite.

    Attributes:
        at: where in the range.
        primal, gradient: relative errors; `gradient` None where there is nothing to differentiate.
    """

    at: str
    primal: float
    gradient: float | None = None


@dataclass(frozen=True)
class Case:
    """A promise, and how it is tried.

    Attributes:
        name: one word for the command line and for tests.
        subject: the file of cases that it is in.
        what: what is computed.
        over: the range that it is tried over.
        primal, gradient: largest relative errors promised; `gradient` None where there is none.
        relative_to: what errors are relative to, if not to the value itself; where none is allowed, what that means.
        measure: tries it; a result for each point of the range.
        long: whether it takes more than a few seconds.
    """

    name: str
    subject: str
    what: str
    over: str
    primal: float
    gradient: float | None
    relative_to: str
    measure: Callable[[], Iterable[Measured]] = field(repr=False)
    long: bool = False

    def run(self) -> Result:
        """Tries the case; what it raises comes out."""
        return Result(self, tuple(self.measure()))

    def attempt(self) -> Result:
        """As :meth:`run`, but what it raises is a point of the range at which nothing is right."""
        rows = []
        try:
            for row in self.measure():
                rows.append(row)
        except Exception as error:
            rows.append(Measured(f"raised {error!r}", math.inf, None if self.gradient is None else math.inf))
        return Result(self, tuple(rows))


@dataclass(frozen=True)
class Result:
    """What a case has measured."""

    case: Case
    rows: tuple[Measured, ...]

    @property
    def primal(self) -> float:
        """The largest error of values; infinite where nothing was measured."""
        return max((row.primal for row in self.rows), default=math.inf)

    @property
    def gradient(self) -> float | None:
        """The largest error of gradients, None where the case has none."""
        if self.case.gradient is None:
            return None
        return max((row.gradient for row in self.rows if row.gradient is not None), default=math.inf)

    @property
    def failures(self) -> list[Measured]:
        """The points at which the promise is broken."""
        return [row for row in self.rows
                if not row.primal <= self.case.primal
                or row.gradient is not None and not row.gradient <= (self.case.gradient or 0.0)]

    @property
    def passed(self) -> bool:
        """Whether the promise is kept everywhere, and all was finite."""
        return bool(self.rows) and not self.failures and self.primal < math.inf and (self.gradient or 0.0) < math.inf


CASES: dict[str, Case] = {}
"""Every case by its name, in the order of definition; :mod:`ndf_mi.stability.suite` fills it."""


def case(
    what: str, over: str, *, primal: float = PROMISE, gradient: float | None = PROMISE, relative_to: str = "", long: bool = False
) -> Callable[[Callable[[], Iterable[Measured]]], Callable[[], Iterable[Measured]]]:
    """Makes the decorated function a case, under its own name."""

    def add(measure: Callable[[], Iterable[Measured]]) -> Callable[[], Iterable[Measured]]:
        name = measure.__name__.replace("_", "-")
        subject = measure.__module__.rpartition(".")[2]
        CASES[name] = Case(name, subject, what, over, primal, gradient, relative_to, measure, long)
        return measure

    return add


def error(found: Any, expected: Any, scale: Any = None) -> float:
    """The largest difference of `found` from `expected`, relative to `scale`, by default the magnitude of `expected`, entry by entry.

    Differences below :data:`LEAST` count as none. Infinite where an entry of `found` is not finite; raises ValueError if shapes differ.
    """
    ours, reference = np.asarray(found, np.float64), np.asarray(expected, np.float64)
    if ours.shape != reference.shape:
        raise ValueError(f"found an array of shape {ours.shape}, reference of {reference.shape}")
    if not np.isfinite(reference).all():
        raise ValueError("a reference that is not finite")
    if not ours.size:
        return 0.0
    if not np.isfinite(ours).all():
        return math.inf
    size = np.broadcast_to(np.abs(reference) if scale is None else np.asarray(scale, np.float64), ours.shape)
    off = np.maximum(np.abs(ours - reference) - LEAST, 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return float(np.where(off > 0, off / size, 0.0).max())
