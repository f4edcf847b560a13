"""Schedules of training on fits whose losses are known."""

from __future__ import annotations

import time

import pytest

from ndf_mi.surface.schedule import Schedule, search, search_frames, train, train_steps


class Decaying:
    """A loss that halves each window of ten steps until `floor`, and the rates that it was given."""

    frames = 5

    def __init__(self, floor: float = 0.01) -> None:
        self.floor = floor
        self.factors: list[float] = []
        self.numbers: list[int] = []

    def set_rate(self, factor: float) -> None:
        self.factors.append(factor)

    def step(self, number: int) -> float:
        self.numbers.append(number)
        return max(0.5 ** (number // 10), self.floor)


SHORT = Schedule(window_steps=8, drops=2, drop=0.5)


def test_convergence_lowers_the_rates_at_plateaus_and_ends():
    fit = Decaying()
    training = train(fit, SHORT)
    # Windows hold whole passes, ten steps; seven of them fall, three are plateaus.
    assert training.converged and training.steps == 110 and fit.numbers == list(range(110))
    assert fit.factors == [1.0, 0.5, 0.25]
    assert [entry[0] for entry in training.history] == list(range(10, 111, 10))
    assert [entry[2] for entry in training.history][:3] == [1.0, 0.5, 0.25]


def test_the_limit_of_steps_ends_a_training_that_does_not_converge():
    training = train(Decaying(), Schedule(window_steps=8, max_steps=25))
    assert not training.converged and training.steps == 25 and len(training.history) == 2


def test_a_time_limit_is_kept_while_the_rates_decay():
    class Slow(Decaying):
        def step(self, number: int) -> float:
            time.sleep(0.01)
            return super().step(number)

    fit, calls = Slow(), []
    training = train(fit, SHORT, 0.2, lambda *values: calls.append(values))
    assert 0.2 <= training.seconds < 2 and not training.converged
    assert fit.factors[0] == pytest.approx(1, abs=0.1) and fit.factors == sorted(fit.factors, reverse=True)
    assert [steps for _, steps, _ in calls] == list(range(1, training.steps + 1)) and calls[0][2] == 1.0
    assert train(Decaying(), SHORT, 0.0).steps == 1


def test_a_number_of_steps_ends_near_the_final_rate():
    fit = Decaying()
    assert train_steps(fit, Schedule(final_rate=0.1), 20) == 0.5
    assert fit.factors[0] == 1 and fit.factors[10] == pytest.approx(0.1**0.5)


def test_a_search_takes_the_lowest_loss():
    found = search(lambda rate: Decaying(rate), (0.7, 0.3, 0.4), Schedule(search_steps=30))
    assert found.rate == 0.3 and found.losses == {"0.7": 0.7, "0.3": 0.3, "0.4": 0.4} and found.seconds >= 0


def test_frames_of_a_search_are_spread():
    assert search_frames(range(10, 30), Schedule(search_frames=3)) == [10, 20, 29]
    assert search_frames([4, 7], Schedule()) == [4, 7] and search_frames([], Schedule()) == []
