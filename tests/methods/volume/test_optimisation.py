"""Adam on named tensors, held against a quadratic whose minimum is known, and against bad gradients."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.methods.volume.optimisation import Optimisation, Outcome, Schedule

TARGET = {"a": np.array([1.0, -2.0], np.float32), "b": np.array([3.0], np.float32)}
ZERO = {name: np.zeros_like(value) for name, value in TARGET.items()}


def distance(parameters, rng) -> Outcome:
    noise = rng.random()
    loss = mi.Float(0)
    for name, target in TARGET.items():
        loss = loss + dr.sum(dr.square(parameters[name] - mi.Float(target)))
    return Outcome(loss * float(0.5 + noise), dr.detach(loss))


def taken(optimisation, steps):
    for _ in range(steps):
        optimisation.step()
    return optimisation


def test_it_finds_the_minimum():
    found = taken(Optimisation(ZERO, distance, Schedule(400, 0.1)), 400)
    assert found.done == 1 and found.error < 1e-3
    for name, target in TARGET.items():
        np.testing.assert_allclose(found.parameters[name], target, atol=1e-2)


def test_rates_differ_by_tensor_and_decay():
    schedule = Schedule(100, 0.1, decay=0.1)
    found = taken(Optimisation(ZERO, distance, schedule, rates={"b": 0.25}), 1)
    # The first step of Adam is as long as the rate.
    np.testing.assert_allclose(found.parameters["a"], [0.1, -0.1], rtol=1e-4)
    np.testing.assert_allclose(found.parameters["b"], [0.025], rtol=1e-4)
    taken(found, 98)
    before = found.parameters["b"].numpy()
    taken(found, 1)
    assert 0 < np.abs(found.parameters["b"].numpy() - before)[0] < 0.3 * 0.025


def test_it_continues_exactly():
    whole = taken(Optimisation(ZERO, distance, Schedule(60, 0.1), seed=3), 60)
    half = taken(Optimisation(ZERO, distance, Schedule(60, 0.1), seed=3), 30)
    again = Optimisation(ZERO, distance, Schedule(60, 0.1), seed=3)
    again.restore(half.tensors(), half.metadata(), "state")
    taken(again, 30)
    for name in TARGET:
        np.testing.assert_array_equal(again.parameters[name], whole.parameters[name])
    assert [row[0] for row in again.history] == [row[0] for row in whole.history] == [25, 50, 60]
    assert [row[2] for row in again.history] == [row[2] for row in whole.history]


def test_tensors_are_exchanged_for_others_of_another_size():
    found = taken(Optimisation({"a": np.zeros(3, np.float32), "b": ZERO["b"]},
                               lambda p, rng: distance({**p, "a": dr.gather(mi.Float, p["a"], [0, 1])}, rng),
                               Schedule(100, 0.1)), 5)
    before = found.parameters["b"].numpy()
    found.exchange({"a": np.full(5, 7, np.float32)})
    np.testing.assert_array_equal(found.parameters["a"], np.full(5, 7))
    np.testing.assert_array_equal(found.parameters["b"], before)
    # Adam begins again: its first step is as long as the rate.
    rate = 0.1 * 0.1 ** (5 / 100)
    taken(found, 1)
    np.testing.assert_allclose(np.abs(found.parameters["b"].numpy() - before), rate, rtol=1e-3)
    np.testing.assert_allclose(found.parameters["a"], [7 - rate, 7 - rate, 7, 7, 7], rtol=1e-4)


def test_steps_that_are_not_finite_are_refused():
    calls = []

    def sometimes(parameters, rng):
        calls.append(1)
        outcome = distance(parameters, rng)
        return Outcome(outcome.loss * float("nan"), outcome.error) if len(calls) == 5 else outcome

    found = taken(Optimisation(ZERO, sometimes, Schedule(100, 0.1)), 20)
    assert found.steps == 19 and found.steps_refused == 1 and np.isfinite(found.parameters["a"].numpy()).all()
    never = Optimisation(ZERO, lambda p, rng: Outcome(distance(p, rng).loss * float("inf"), mi.Float(0)),
                         Schedule(100, 0.1))
    with pytest.raises(InputError, match="refused steps"):
        taken(never, 100)
    with pytest.raises(InputError, match="state.*adam.a.value"):
        found.restore({}, {}, "state")
    with pytest.raises(InputError, match="metadata"):
        found.restore(found.tensors(), {}, "state")
