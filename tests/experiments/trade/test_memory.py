"""Peak memory of allocations that are known."""

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import pytest

from ndf_mi.experiments.trade.memory import peak_memory

#: Numbers in an array of 16 MiB.
COUNT = 1 << 22


def array(first: float) -> mi.Float:
    """Numbers in memory."""
    values = dr.arange(mi.Float, COUNT) + dr.opaque(mi.Float, first)
    dr.eval(values)
    return values


def in_turns() -> list[mi.Float]:
    """Two arrays, of which the first is gone before the second is made: its block is used again."""
    first = array(0.0)
    dr.sync_thread()
    del first
    return [array(1.0)]


@pytest.mark.parametrize(
    ("draw", "arrays"),
    [(lambda: [array(0.0)], 1), (lambda: [array(float(i)) for i in range(3)], 3), (in_turns, 1), (list, 0)],
)
def test_the_most_that_was_allocated_beyond_what_lay_there(
    draw: Callable[[], list[mi.Float]], arrays: int
) -> None:
    before = [array(float(i)) for i in range(2)]
    # What is freed before is no memory of the next, and no room for it either.
    del before[1]
    result, peak = peak_memory(draw)
    assert arrays * 4 * COUNT <= peak <= arrays * 4 * COUNT + (1 << 20)
    assert len(result) == arrays and len(before) == 1
