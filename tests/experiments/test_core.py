"""Units of work: done once, done again when stale, continued after a stop; without any rendering."""

from __future__ import annotations

from pathlib import Path

import pytest

from ndf_mi.experiments.core import Progress, Unit, run_units
from ndf_mi.experiments.records import Trained
from ndf_mi.experiments.store import Store


class Work:
    """Units that count what they do; `stop_at` is the key of one during which the user interrupts."""

    def __init__(self, stop_at: str = "") -> None:
        self.done: list[str] = []
        self.stop_at = stop_at

    def unit(self, key: str, outputs: tuple[Path, ...] = (), **inputs: object) -> Unit[Trained]:
        def work() -> Trained:
            if key == self.stop_at:
                raise KeyboardInterrupt
            self.done.append(key)
            for path in outputs:
                path.write_text("output")
            return Trained({"from": key})

        return Unit(key, inputs, work, Trained, outputs, f"label {key}", "group")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "study.json"


def test_records_are_kept_in_order_and_nothing_is_done_twice(file: Path) -> None:
    work = Work()
    units = [work.unit(key, capture="x", size=[3, 4], limit=None) for key in "abc"]
    first = run_units(units, Store(file, "fake"))
    assert [record.metadata["from"] for record in first] == ["a", "b", "c"]
    assert run_units(units, Store(file, "fake")) == first
    assert work.done == ["a", "b", "c"]


@pytest.mark.parametrize("changed", [{"capture": "other"}, {"extra": 1}, {"size": (4, 3)}, {"capture": None}])
def test_a_changed_input_makes_only_its_record_stale(file: Path, changed: dict[str, object]) -> None:
    inputs = {"capture": "x", "size": (3, 4)}
    run_units([Work().unit(key, **inputs) for key in "ab"], Store(file, "fake"))
    work, store = Work(), Store(file, "fake")
    units = [work.unit("a", **inputs), work.unit("b", **{**inputs, **changed})]
    assert store.staleness(units[0]) == "" and all(name in store.staleness(units[1]) for name in changed)
    assert store.fresh(units[0]) is not None and store.fresh(units[1]) is None
    run_units(units, store)
    assert work.done == ["b"]


def test_a_missing_output_is_made_again(file: Path, tmp_path: Path) -> None:
    work, output = Work(), tmp_path / "picture.png"
    for _ in range(2):
        run_units([work.unit("a", (output,))], Store(file, "fake"))
    output.unlink()
    assert "picture.png" in Store(file, "fake").staleness(work.unit("a", (output,)))
    run_units([work.unit("a", (output,))], Store(file, "fake"))
    assert work.done == ["a", "a"] and output.exists()


def test_a_stopped_list_continues_where_it_stopped(file: Path) -> None:
    stopped = Work(stop_at="c")
    with pytest.raises(KeyboardInterrupt):
        run_units([stopped.unit(key) for key in "abcd"], Store(file, "fake"))
    again = Work()
    run_units([again.unit(key) for key in "abcd"], Store(file, "fake"))
    assert (stopped.done, again.done) == (["a", "b"], ["c", "d"])


def test_units_do_not_depend_on_their_order_or_on_being_in_one_list(file: Path) -> None:
    run_units([Work().unit("b")], Store(file, "fake"))
    work, store = Work(), Store(file, "fake")
    run_units([work.unit(key) for key in "cba"], store)
    assert work.done == ["c", "a"] and set(store.matching("", Trained)) == {"a", "b", "c"}


def test_progress_counts_the_units_of_a_group(file: Path) -> None:
    class Watching(Progress):
        seen: list[tuple[str, str, int, int]] = []

        def begin(self, unit, number, of, why):
            self.seen.append((why, unit.label, number, of))

        def done(self, unit, number, of):
            # Stored before it is reported, so that a kill right now loses nothing.
            assert Store(file, "fake").staleness(unit) == ""
            self.seen.append(("done", unit.label, number, of))

    run_units([Work().unit("a")], Store(file, "fake"))
    run_units([Work().unit(key) for key in "ab"], Store(file, "fake"), Watching())
    assert Watching.seen == [("no record", "label b", 2, 2), ("done", "label b", 2, 2)]


def test_equal_keys_are_a_mistake_of_the_program(file: Path) -> None:
    with pytest.raises(ValueError, match="same key"):
        run_units([Work().unit("a"), Work().unit("a")], Store(file, "fake"))
