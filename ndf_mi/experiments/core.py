"""The core of every experiment: units of work that are done once, recorded at once, and repeated only when
stale.

A unit trains one thing, renders and measures one image, or times one round. An experiment lists its units;
`run_units` does those whose record is missing or stale and stores each record as soon as it exists, so that a
killed experiment loses at most one unit. Units do not depend on the order in which they run, except that
images need a trained method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from msgspec import Struct

if TYPE_CHECKING:
    from ndf_mi.experiments.store import Store

R = TypeVar("R", bound=Struct)


@dataclass(frozen=True)
class Unit(Generic[R]):
    """A piece of work that results in one record.

    Attributes:
        key: the name of the record, unique in a study.
        inputs: everything that the record depends on, by name, as JSON values: digests of capture and
            weights, settings, for timings the machine. When one of them changes, the record is stale.
        work: does it and returns the record. It changes nothing but the files in `outputs`.
        record: the type of the record.
        outputs: files or folders that the work leaves; without them the record does not count.
        label: what progress reports call it.
        group: units of the same group are counted together; by default those of the same label.
    """

    key: str
    inputs: Mapping[str, Any]
    work: Callable[[], R]
    record: type[R]
    outputs: tuple[Path, ...] = ()
    label: str = ""
    group: str = ""


class Progress:
    """Receives progress reports; this one ignores them."""

    def training(self, label: str, seconds: float, budget: float | None, step: int, loss: float) -> None:
        """A step of the training that a unit with this label does: seconds and steps so far, the time that it
        was given, if any, and the step's mean squared error in sRGB."""

    def begin(self, unit: Unit[Any], number: int, of: int, why: str) -> None:
        """A unit begins: the `number`-th of the `of` units of its group, because its record is missing or
        stale as `Store.staleness` describes."""

    def done(self, unit: Unit[Any], number: int, of: int) -> None:
        """The record of a unit is stored."""


SILENT = Progress()


def run_units(units: Iterable[Unit[R]], store: Store, progress: Progress = SILENT) -> list[R]:
    """Does the units whose records are missing or stale.

    Args:
        units: the units, in the order in which they are done.
        store: where records are looked up and stored, each as soon as it exists.
        progress: is called before and after each unit that is done.

    Returns:
        the records of all units, in order.

    Raises:
        ValueError: two units have the same key.
        KeyboardInterrupt: stopped by the user; the next call does the rest.
    """
    units = list(units)
    if len({unit.key for unit in units}) < len(units):
        raise ValueError(f"units with the same key: {sorted(unit.key for unit in units)}")
    groups = [unit.group or unit.label for unit in units]
    records = []
    for index, (unit, group) in enumerate(zip(units, groups, strict=True)):
        record, why = store.fresh(unit), store.staleness(unit)
        if record is None:
            number, of = groups[: index + 1].count(group), groups.count(group)
            progress.begin(unit, number, of, why)
            record = unit.work()
            store.put(unit, record)
            progress.done(unit, number, of)
        records.append(record)
    return records
