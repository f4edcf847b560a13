"""Timing the points of a trade in turns: repeats that hit every point alike, and sessions of repeats."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from ndf_mi.experiments.core import Unit
from ndf_mi.experiments.store import Store
from ndf_mi.experiments.trade.points import Point
from ndf_mi.experiments.trade.rendering import Renderings
from ndf_mi.experiments.trade.results import Timing

_FIRST_SEED = 3
"""Seed of path-traced pictures in the first repeat; later repeats count on."""


class Session:
    """Points that are timed in turns. The kernels are compiled in a round that does not count.

    Args:
        points: the points.
        renderings: draws them.
        machine: as in `Timing`.
        timed: number of timed views.
        seed: seed of the orders.

    Attributes:
        name: a digest of the conditions.
    """

    def __init__(
        self, points: Sequence[Point], renderings: Renderings, machine: Mapping[str, str], timed: int,
        seed: int,
    ) -> None:
        self._points, self._renderings, self._seed = points, renderings, seed
        self._machine, self._timed = dict(machine), timed
        self._cache_keys = {point.key: renderings.cache_key(point) for point in points}
        self._compiled = False
        keys = list(self._cache_keys.values())
        self.name = digest_of({"machine": self._machine, "points": keys, "timed": timed})

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
        return Timing(self._machine, self._timed, self._cache_keys, self._round(repeat + 1))

    def _round(self, number: int) -> dict[str, float]:
        """Mean seconds of each point over its views. In each view, all points are rendered in an order drawn
        at random.
        """
        rng = np.random.default_rng([self._seed, number])
        views = [self._renderings.timed(point) for point in self._points]
        taken: dict[str, list[float]] = {point.key: [] for point in self._points}
        for turn in range(max(map(len, views))):
            for index in rng.permutation(len(self._points)):
                point = self._points[index]
                if turn < len(views[index]):
                    begun = time.perf_counter()
                    self._renderings.draw(point, views[index][turn], _FIRST_SEED + max(number - 1, 0))
                    taken[point.key].append(time.perf_counter() - begun)
        return {key: float(np.mean(seconds)) for key, seconds in taken.items()}


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
