"""Keeps a training sound: a step whose gradient is not finite, or that would make weights so, is not taken."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.errors import InputError

KEEP_EVERY = 100
"""Steps after which the optimisers' state is kept as one to go back to."""
PATIENCE = 8
"""Refused steps, without a state kept in between, after which training stops."""
FACTOR = 0.5
"""On the learning rates, at each refused step."""
RECOVERY = 10
"""States kept, without a refused step in between, after which the rates are doubled again, up to what was asked for."""

HARMLESS = 1e30
"""Learning rates below which no step leads out of the range of floats: Adam's are at most ten rates long."""


class Guard:
    """Watches over the optimisers of a training.

    A step is sound if the loss and the sum of squares of all gradients are finite: then neither a weight nor Adam's second moment, which
    holds those squares, can become otherwise, but at rates near the end of the range of floats: there the weights are looked at after the
    step. At one that is not sound, the optimisers go back to the last state kept, and the rates are halved.
    A state is kept only once a step from it has proved sound.

    What it knows is not part of a checkpoint but for `factor` and `refused`: a training resumed between a kept state and a refused step
    goes back to the checkpoint instead.

    Args:
        optimisers: as many ``mi.ad.Adam`` as the training has.

    Attributes:
        factor: on the learning rates, 1 as long as every step was sound.
        refused: number of steps refused so far.
    """

    def __init__(self, optimisers: list[Any]) -> None:
        self._optimisers = optimisers
        self.factor = 1.0
        self.refused = 0
        self._in_a_row = 0
        self._calm = 0
        self._proved = -1
        self.keep()

    def keep(self) -> None:
        """Takes the present state as the one to go back to. Arrays are shared, not copied."""
        self._states = [{key: _detached(entry) for key, entry in optimiser.state.items()} for optimiser in self._optimisers]

    def follow(self, other: Guard) -> None:
        """Takes over what a guard of optimisers that these replace has come to: its count, and its factor on the rates."""
        self.factor, self.refused = other.factor, other.refused

    def sound(self, loss: mi.Float) -> bool:
        """Whether a step can be taken: to be asked when the gradients are there and the optimisers have not used them yet. `loss` is one
        number."""
        total = mi.Float(loss)
        for optimiser in self._optimisers:
            for key in optimiser.keys():  # noqa: SIM118 - not a dict
                total = total + dr.sum(dr.square(dr.grad(optimiser[key])))
        return math.isfinite(float(dr.detach(total)[0]))

    def proved(self, step: int) -> None:
        """To be called where the step from the present state has proved sound, before it is taken.

        Args:
            step: how many steps have been taken.
        """
        # A step that is tried again has proved nothing new.
        if step % KEEP_EVERY or step == self._proved:
            return
        self._proved = step
        self.keep()
        self._in_a_row = 0
        self._calm += 1
        if self._calm >= RECOVERY:
            self.factor = min(1.0, self.factor / FACTOR)
            self._calm = 0

    def landed(self, rate: float) -> bool:
        """Whether all values are finite after the step just taken, at rates of at most `rate`: looked at only where it may be otherwise."""
        if rate < HARMLESS:
            return True
        return all(bool(dr.all(dr.isfinite(optimiser[key]))) for optimiser in self._optimisers for key in optimiser.keys())  # noqa: SIM118

    def refuse(self, step: int) -> None:
        """To be called in place of a step that is not sound: goes back, and makes the rates smaller.

        Args:
            step: the step's number, for the message.

        Raises:
            InputError: that has not helped; the optimisers are at the last state kept.
        """
        self.refused += 1
        self._in_a_row += 1
        self._calm = 0
        for optimiser, state in zip(self._optimisers, self._states, strict=True):
            for key, (value, promoted, rate, moments) in state.items():
                # Setting a value tracks its gradients anew.
                optimiser[key] = value
                optimiser.state[key] = (optimiser.state[key][0], promoted, rate, moments)
        if self._in_a_row > PATIENCE:
            raise InputError(
                f"step {step}", f"{PATIENCE} steps refused of late, because loss, gradient or the weights after it were not finite",
                "a training that goes on at smaller steps",
                f"The learning rate has come down to {self.factor:g} of what was asked for, in vain: start another run with a smaller one, "
                "`--option learning_rate=...`.")
        self.factor *= FACTOR


def _detached(entry: tuple[Any, ...]) -> tuple[Any, ...]:
    value, *rest = entry
    return (type(value)(dr.detach(value)), *rest)
