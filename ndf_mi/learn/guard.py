"""Refuses training steps that are not finite and returns to the last good state."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.errors import InputError

KEEP_EVERY = 100
"""Steps between two snapshots of the optimisers' state."""
PATIENCE = 8
"""Number of refused steps since the last snapshot after which training stops."""
FACTOR = 0.5
"""Factor on the learning rates at each refused step."""
RECOVERY = 10
"""Snapshots in a row without a refused step after which reduced rates double."""

HARMLESS = 1e30
"""Learning rates below which no step overflows float32: an Adam step is at most ten rates long."""


class Guard:
    """Watches the optimisers of a training.

    A step is taken if the loss and the sum of squares of all gradients are finite. Then neither the
    parameters nor Adam's second moments, which hold those squares, can overflow, except at rates near the
    largest float: there the parameters are checked after the step. When a step is refused, the optimisers
    return to the last snapshot and the learning rates are halved. A snapshot is taken only of a state whose
    next step has finite gradients.

    Of the guard's state, checkpoints hold only `rate_factor` and `steps_refused`: a resumed training returns
    to its checkpoint instead of the snapshot.

    Args:
        optimisers: the training's ``mi.ad.Adam`` instances.

    Attributes:
        rate_factor: factor on the learning rates; 1 until a step is refused.
        steps_refused: number of steps refused so far.
    """

    def __init__(self, optimisers: list[Any]) -> None:
        self.rate_factor = 1.0
        self.steps_refused = 0
        self.watch(optimisers)

    def watch(self, optimisers: list[Any]) -> None:
        """Watches these optimisers in place of the ones before."""
        self._optimisers = optimisers
        self._refused_since_snapshot = 0
        self._snapshots_in_a_row = 0
        self._last_stable = -1
        self.snapshot()

    def snapshot(self) -> None:
        """Keeps the present state as the one to return to. Arrays are shared, not copied."""
        self._states = [{key: _detached(entry) for key, entry in optimiser.state.items()}
                        for optimiser in self._optimisers]

    def gradients_finite(self, loss: mi.Float) -> bool:
        """Whether the step can be taken. Call it after the backward pass and before the optimisers' step.

        Args:
            loss: one number.
        """
        total = mi.Float(loss)
        for optimiser, key in self._parameters():
            total = total + dr.sum(dr.square(dr.grad(optimiser[key])))
        return math.isfinite(float(dr.detach(total)[0]))

    def mark_stable(self, step: int) -> None:
        """Records that the step from the present state has finite gradients. Call it before that step is
        taken.

        Args:
            step: number of steps taken so far.
        """
        # A repeated step is no new evidence.
        if step % KEEP_EVERY or step == self._last_stable:
            return
        self._last_stable = step
        self.snapshot()
        self._refused_since_snapshot = 0
        self._snapshots_in_a_row += 1
        if self._snapshots_in_a_row >= RECOVERY:
            self.rate_factor = min(1.0, self.rate_factor / FACTOR)
            self._snapshots_in_a_row = 0

    def params_finite(self, rate: float) -> bool:
        """Whether all parameters are finite after a step at learning rates of at most `rate`.

        Reads the parameters only where `rate` is so large that they could have overflowed.
        """
        if rate < HARMLESS:
            return True
        return all(bool(dr.all(dr.isfinite(optimiser[key]))) for optimiser, key in self._parameters())

    def refuse(self, step: int) -> None:
        """Returns to the last snapshot and halves the learning rates.

        Args:
            step: the refused step's number, for the message.

        Raises:
            InputError: smaller rates have not helped; the optimisers hold the last snapshot.
        """
        self.steps_refused += 1
        self._refused_since_snapshot += 1
        self._snapshots_in_a_row = 0
        for optimiser, state in zip(self._optimisers, self._states, strict=True):
            for key, (value, promoted, rate, moments) in state.items():
                # Assigning a value enables its gradients again.
                optimiser[key] = value
                optimiser.state[key] = (optimiser.state[key][0], promoted, rate, moments)
        if self._refused_since_snapshot > PATIENCE:
            raise InputError(
                f"step {step}",
                f"{PATIENCE} refused steps: loss, gradients or updated parameters were not finite",
                "a training that continues with smaller steps",
                f"Reducing the learning rate to {self.rate_factor:g} of the requested one did not help. "
                "Start another run with a smaller one: `--option learning_rate=...`.")
        self.rate_factor *= FACTOR

    def _parameters(self) -> list[tuple[Any, str]]:
        return [(optimiser, key) for optimiser in self._optimisers
                for key in optimiser.keys()]  # noqa: SIM118


def _detached(entry: tuple[Any, ...]) -> tuple[Any, ...]:
    value, *rest = entry
    return (type(value)(dr.detach(value)), *rest)
