"""The Pareto front against its definition, and the knee of curves that are known."""

import math

import numpy as np
import pytest

from ndf_mi.experiments.trade.front import knee, pareto_front


@pytest.mark.parametrize("seed", range(4))
def test_the_front_is_what_no_other_point_beats(seed):
    rng = np.random.default_rng(seed)
    cost, quality = rng.integers(1, 9, 40).astype(float), rng.integers(1, 9, 40).astype(float)
    front = pareto_front(cost, quality)

    def beaten(i):
        return any(
            cost[j] <= cost[i] and quality[j] >= quality[i] and (cost[j], quality[j]) != (cost[i], quality[i])
            for j in range(40)
        )

    assert {(cost[i], quality[i]) for i in front} == {
        (cost[i], quality[i]) for i in range(40) if not beaten(i)
    }
    assert len(front) == len({(cost[i], quality[i]) for i in front})
    assert (np.diff(cost[front]) > 0).all() and (np.diff(quality[front]) > 0).all()


def test_the_first_of_equal_points_stays_and_infinite_quality_is_best():
    assert pareto_front([1.0, 1.0], [2.0, 2.0]) == [0]
    assert pareto_front([3.0, 1.0, 2.0], [math.inf, 1.0, 0.5]) == [1, 0]
    assert pareto_front([], []) == []


def test_what_is_hardly_better_is_not_worth_more():
    assert pareto_front([1.0, 2.0, 3.0, 4.0], [30.0, 30.004, 30.008, 31.0], 0.005) == [0, 2, 3]


def test_the_knee_is_where_a_bent_line_bends():
    cost = np.exp(np.arange(10.0))
    quality = np.where(np.arange(10) < 4, 5.0 * np.arange(10), 15.0 + 0.1 * np.arange(10))
    assert knee(cost, quality) == 3
    # The one of 1 − e^−5x over x from 0 to 1, from which its chord is taken, lies at x = ln(5 / (1 − e⁻⁵)) /
    # 5.
    x = np.linspace(0, 1, 1001)
    assert x[knee(np.exp(x), 1 - np.exp(-5 * x))] == pytest.approx(
        math.log(5 / (1 - math.exp(-5))) / 5, abs=1e-3
    )


def test_there_is_no_knee_in_a_straight_line_or_two_points():
    assert knee([1.0, math.e, math.e**2], [1.0, 2.0, 3.0]) is None
    assert knee([1.0, 2.0], [1.0, 2.0]) is None
    assert knee([1.0, 2.0, 4.0], [1.0, 9.0, math.inf]) == 1
