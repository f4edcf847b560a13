"""Timing the points of a trade in turns: repeats that hit every point alike, and sessions of repeats."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ndf_mi.experiments.core import Unit
from ndf_mi.experiments.records import View
from ndf_mi.experiments.store import Store
from ndf_mi.experiments.trade.points import Point
from ndf_mi.experiments.trade.results import Timing

_FIRST_SEED = 3
"""Seed of path-traced pictures in the first repeat; later repeats count on."""


@dataclass
class Session:
    """Conditions under which points are timed together. The kernels are compiled in a round that does not
    count.

    Args:
        points: the points.
        cache_keys: theirs.
        views: the timed views of a point.
        render: renders a point in a view, with a seed.
        machine: as in `Timing`.
        timed: number of timed views.
        seed: seed of the orders.
    """

    points: Sequence[Point]
    cache_keys: Sequence[str]
    views: Callable[[Point], Sequence[View]]
    render: Callable[[Point, View, int], object]
    machine: Mapping[str, str]
    timed: int
    seed: int
    _compiled: bool = field(default=False, init=False)

    @property
    def name(self) -> str:
        """A digest of the conditions."""
        return digest_of(
            {"machine": dict(self.machine), "points": list(self.cache_keys), "timed": self.timed}
        )

    def units(self, repeats: int) -> list[Unit[Timing]]:
        """One unit a repeat."""
        inputs = {"session": self.name}

        def unit(repeat: int) -> Unit[Timing]:
            return Unit(
                f"timing/{self.name}/{repeat}", inputs, lambda: self._repeat(repeat), Timing,
                label="time all points",
            )

        return [unit(repeat) for repeat in range(repeats)]

    def _repeat(self, repeat: int) -> Timing:
        if not self._compiled:
            self._round(0)
            self._compiled = True
        taken = self._round(repeat + 1)
        keys = [point.key for point in self.points]
        return Timing(
            dict(self.machine), self.timed, dict(zip(keys, self.cache_keys, strict=True)),
            dict(zip(keys, taken, strict=True)),
        )

    def _round(self, number: int) -> list[float]:
        """Mean seconds of each point over its views. In each view, all points are rendered in an order drawn
        at random.
        """
        rng = np.random.default_rng([self.seed, number])
        taken: list[list[float]] = [[] for _ in self.points]
        for turn in range(max(len(self.views(point)) for point in self.points)):
            for index in rng.permutation(len(self.points)):
                point = self.points[index]
                if turn < len(self.views(point)):
                    begun = time.perf_counter()
                    self.render(point, self.views(point)[turn], _FIRST_SEED + max(number - 1, 0))
                    taken[index].append(time.perf_counter() - begun)
        return [float(np.mean(seconds)) for seconds in taken]


def digest_of(conditions: Mapping[str, Any]) -> str:
    """A short digest of JSON values."""
    return hashlib.sha256(json.dumps(conditions, sort_keys=True).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Timings:
    """All timings that a study has stored.

    Attributes:
        repeats: the repeats of each session, by its name, from the oldest session to the newest.
    """

    repeats: Mapping[str, list[Timing]]

    @classmethod
    def read(cls, store: Store) -> Timings:
        """The stored timings. Raises InputError if they are damaged."""
        found: dict[str, list[Timing]] = {}
        for key, timing in store.matching("timing/", Timing).items():
            found.setdefault(key.split("/")[1], []).append(timing)
        return cls(found)

    def of(self, key: str, cache_key: str, session: str | None = None) -> tuple[str, list[float]]:
        """Session and seconds of a point with this cache key: of the given session, or of the newest that
        timed it.
        """
        for name in reversed(list(self.repeats)) if session is None else [session]:
            timings = self.repeats.get(name, [])
            if timings and all(timing.points.get(key) == cache_key for timing in timings):
                return name, [timing.seconds[key] for timing in timings]
        return "", []
