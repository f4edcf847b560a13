"""Which method is for whom: what follows from the figures of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median

from ndf_mi.experiments import metrics
from ndf_mi.experiments.records import HELD_OUT, SPLITS, Results, Trainings
from ndf_mi.reports import tables
from ndf_mi.reports.page import Fact

EQUAL = 0.1
"""dB within which two methods count as equally good, unless seeds differ by more."""
SAME_COST = 0.05
"""Share by which two costs may differ and count as the same."""


def advice(results: Results) -> list[Fact]:
    """The best method for each need, with its figures; methods that are equally good are named together.

    Needs that the figures say nothing about are left out: quality needs two methods with held-out images, a
    cost two methods that differ in it.
    """
    methods = [each for each in results.trainings() if _quality(each, HELD_OUT) is not None]
    facts = [_best(SPLITS[split].capitalize(), methods, (split,), "box_psnr") for split in HELD_OUT]
    shown = tuple(dict.fromkeys(known.sequence.split for each in methods for known in each.first.flicker))
    facts.append(_best("Steady pictures in motion", methods, shown, metrics.TEMPORAL))
    facts += [
        _cheapest("Little training time", methods, lambda each: _known(each, "seconds"), tables.duration),
        _cheapest("Quick pictures", methods, lambda each: each.first.seconds_an_image(), tables.duration),
        _cheapest("Little memory in training", methods, lambda each: _known(each, "peak_memory"),
                  lambda value: tables.size(int(value))),
        _cheapest("Small files", methods, lambda each: _known(each, "size_on_disk"),
                  lambda value: tables.size(int(value))),
    ]
    return [fact for fact in facts if fact is not None]


def _best(need: str, methods: Sequence[Trainings], splits: Sequence[str], metric: str) -> Fact | None:
    known = [(value, each) for each in methods if (value := _quality(each, splits, metric)) is not None]
    if len(known) < 2:
        return None
    known.sort(key=lambda pair: -pair[0])
    top, first = known[0]
    unit = "dB of box PSNR" if metric == "box_psnr" else "dB of temporal PSNR"
    level = [pair for pair in known if top - pair[0] <= _tolerance(first, pair[1], splits, metric)]
    behind = [pair for pair in known if pair not in level]
    text = f"{_joined([each.label for _, each in level])}: {tables.figure(metric, top)} {unit}"
    text += f" and at most {tables.figure(metric, top - level[-1][0])} dB less" if len(level) > 1 else ""
    if behind:
        value, follower = behind[0]
        text += f". Next is {tables.named(follower.label)}, {tables.figure(metric, top - value)} dB behind"
    return Fact(need, (text + ".",))


def _cheapest(need: str, methods: Sequence[Trainings], cost: Callable[[Trainings], float | None],
              written: Callable[[float], str]) -> Fact | None:
    """The method of the least cost, and what it gives up to the best one in quality."""
    known = [(value, each) for each in methods if (value := cost(each))]
    if len(known) < 2 or max(known, key=_first)[0] <= (1 + SAME_COST) * min(known, key=_first)[0]:
        return None
    value, least = min(known, key=_first)
    lines = [f"{tables.named(least.label)}: {written(value)}{_given_up(least, methods)}."]
    qualities = [(quality, each) for each in methods if (quality := _quality(each, HELD_OUT)) is not None]
    best = max(qualities, key=_first)[1]
    of_best = cost(best)
    if best is not least and of_best:
        lines.append(f"The best in quality, {tables.named(best.label)}, takes {written(of_best)}.")
    return Fact(need, (" ".join(lines),))


def _given_up(least: Trainings, methods: Sequence[Trainings]) -> str:
    behind = []
    for split in HELD_OUT:
        known = [value for each in methods if (value := _quality(each, (split,))) is not None]
        mine = _quality(least, (split,))
        if mine is not None and max(known) - mine > EQUAL:
            behind.append(f"{max(known) - mine:.2f} dB behind the best on {SPLITS[split]}")
    return ", " + " and ".join(behind) if behind else ""


def _quality(each: Trainings, splits: Sequence[str], metric: str = "box_psnr") -> float | None:
    """The mean over those splits that have the metric; None where none has, or one is infinite."""
    known = [value for split in splits if (value := each.mean(split, metric)) is not None]
    return sum(known) / len(known) if known and max(known) < float("inf") else None


def _tolerance(one: Trainings, other: Trainings, splits: Sequence[str], metric: str) -> float:
    spreads = [each.spread(split, metric) or 0.0 for each in (one, other) for split in splits]
    return max([EQUAL, *spreads])


def _known(each: Trainings, key: str) -> float | None:
    """The median over the trainings that say."""
    values = [value for member in each.members if (value := member.metadata.get(key))]
    return median(values) if values else None


def _first(pair: tuple[float, Trainings]) -> float:
    return pair[0]


def _joined(labels: Sequence[str]) -> str:
    *rest, last = map(tables.named, labels)
    return f"{', '.join(rest)} and {last}" if rest else last
