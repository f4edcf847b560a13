"""Timing the points of a trade in turns: repeats that hit every point alike, and sessions of repeats."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
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
        points = list(self.cache_keys)
        return digest_of({"machine": dict(self.machine), "points": points, "timed": self.timed})

    def units(self, repeats: int) -> list[Unit[Timing]]:
        """One unit a repeat."""
        key, inputs, label = f"timing/{self.name}", {"session": self.name}, "time all points"
        return [
            Unit(f"{key}/{repeat}", inputs, partial(self._repeat, repeat), Timing, label=label)
            for repeat in range(repeats)
        ]

    def _repeat(self, repeat: int) -> Timing:
        if not self._compiled:
            self._round(0)
            self._compiled = True
        keys, taken = [point.key for point in self.points], self._round(repeat + 1)
        cache_keys = dict(zip(keys, self.cache_keys, strict=True))
        return Timing(dict(self.machine), self.timed, cache_keys, dict(zip(keys, taken, strict=True)))

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


def read_timings(store: Store) -> dict[str, list[Timing]]:
    """The repeats of each stored session, by its name, from the oldest session to the newest.

    Raises:
        InputError: they are damaged.
    """
    found: dict[str, list[Timing]] = {}
    for key, timing in store.matching("timing/", Timing).items():
        found.setdefault(key.split("/")[1], []).append(timing)
    return found


def seconds_of(
    timings: Mapping[str, list[Timing]], key: str, cache_key: str, session: str | None = None
) -> tuple[str, list[float]]:
    """Session and seconds of a point with this cache key: of the given session, or of the newest that timed
    it; empty if there is none.
    """
    for name in reversed(list(timings)) if session is None else [session]:
        repeats = timings.get(name, [])
        if repeats and all(timing.points.get(key) == cache_key for timing in repeats):
            return name, [timing.seconds[key] for timing in repeats]
    return "", []
