"""Adam on named tensors: schedule, clipped gradients, refusal of steps that are not finite, exact resume."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.learn.guard import Guard
from ndf_mi.learn.state import adam_tensors, restore_adam
from ndf_mi.methods.volume.volume import Parameters

LOG_EVERY = 25
"""Steps between two points of the training curve."""
_SMOOTHING = 0.95
PREFIX = "adam"
"""Of the names of values and moments in a checkpoint."""


@dataclass(frozen=True)
class Schedule:
    """How a volume is trained.

    Attributes:
        steps: steps without a budget of seconds, with which there is no other limit.
        learning_rate: Adam's, at first.
        decay: factor by which it decays, exponentially, over `decay_steps` steps.
        decay_steps: 0 for the whole training.
        clip: largest magnitude of an entry of the gradient.
    """

    steps: int
    learning_rate: float
    decay: float = 0.1
    decay_steps: int = 0
    clip: float = 40.0


@dataclass(frozen=True)
class Outcome:
    """What a step computes, one number each.

    Attributes:
        loss: attached to the parameters.
        error: what the training curve shows, detached: mean squared error in sRGB where there are images.
    """

    loss: mi.Float
    error: mi.Float


Objective = Callable[[Parameters, np.random.Generator], Outcome]
"""One step's loss at the parameters. All its random numbers come from the generator, drawn in an order that
does not depend on values, so that a resumed training repeats."""


class Optimisation:
    """A training of named tensors, step by step.

    Args:
        initial: flat float32 tensors by name.
        objective: the loss.
        schedule: rates and length.
        seconds: wall-clock seconds to train for, those spent included; None takes the schedule's steps.
        seed: of the objective's random numbers.
        rates: factors on the learning rate by name; 1 where there is none.
        spent: seconds that count as training and went before; rates decay over the rest of the budget.

    Attributes:
        steps: taken so far.
        seconds: spent so far.
        error: smoothed; NaN before the first step.
        history: [step, seconds, smoothed error], every `LOG_EVERY` steps.
    """

    def __init__(self, initial: Mapping[str, np.ndarray], objective: Objective, schedule: Schedule,
                 seconds: float | None = None, seed: int = 0, rates: Mapping[str, float] | None = None,
                 spent: float = 0.0) -> None:
        self.schedule = schedule
        self._objective = objective
        self._budget, self._spent = seconds, spent
        self._rng = np.random.default_rng([seed, 1])
        self._factors = {name: (rates or {}).get(name, 1.0) for name in initial}
        self._adam = mi.ad.Adam(lr=schedule.learning_rate,
                                params={name: mi.Float(value) for name, value in initial.items()})
        self._guard = Guard([self._adam])
        self.steps, self.seconds, self.error = 0, spent, float("nan")
        self.history: list[tuple[int, float, float]] = []

    @property
    def done(self) -> float:
        """Share of the training that is done, in [0, 1]. At least one step is taken."""
        if self._budget is None:
            return min(1.0, self.steps / self.schedule.steps)
        if not self.steps or self.seconds >= self._budget:
            return float(self.steps > 0)
        return (self.seconds - self._spent) / (self._budget - self._spent)

    @property
    def steps_refused(self) -> int:
        """Steps that were not taken because something was not finite."""
        return self._guard.steps_refused

    @property
    def parameters(self) -> dict[str, mi.Float]:
        """The current parameters, detached."""
        return {name: dr.detach(self._adam[name]) for name in self._factors}

    def step(self) -> None:
        """Takes one step, or refuses it and returns to the last good state.

        Raises:
            InputError: too many steps were refused.
        """
        started = time.perf_counter()
        rate = self._set_rates()
        outcome = self._objective({name: self._adam[name] for name in self._factors}, self._rng)
        dr.backward(outcome.loss)
        if self._guard.gradients_finite(outcome.loss):
            self._guard.mark_stable(self.steps)
            for name in self._factors:
                value = self._adam[name]
                dr.set_grad(value, dr.clip(dr.grad(value), -self.schedule.clip, self.schedule.clip))
            self._adam.step()
            taken = self._guard.params_finite(rate)
        else:
            taken = False
        if taken:
            self.steps += 1
            found = float(outcome.error[0])
            self.error = found if math.isnan(self.error) else \
                _SMOOTHING * self.error + (1 - _SMOOTHING) * found
        else:
            self._guard.refuse(self.steps + 1)
        self.seconds += time.perf_counter() - started
        if taken and (self.steps % LOG_EVERY == 0 or self.done >= 1):
            self.history.append((self.steps, round(self.seconds, 3), self.error))

    def exchange(self, values: Mapping[str, np.ndarray]) -> None:
        """Replaces tensors by others of any size, by name; Adam begins again for all of them."""
        kept = {name: value.numpy() for name, value in self.parameters.items()}
        self._adam = mi.ad.Adam(lr=self.schedule.learning_rate, params={
            name: mi.Float(value) for name, value in {**kept, **values}.items()})
        self._guard.watch([self._adam])

    def tensors(self) -> dict[str, np.ndarray]:
        """Parameters and moments, for a checkpoint."""
        return adam_tensors(self._adam, PREFIX)

    def metadata(self) -> dict[str, Any]:
        """The rest of the state as JSON values."""
        return {
            "steps": self.steps, "seconds": self.seconds,
            "error": None if math.isnan(self.error) else self.error, "history": self.history,
            "rate_factor": self._guard.rate_factor, "refused": self._guard.steps_refused,
            "random": self._rng.bit_generator.state,
        }

    def restore(self, tensors: dict[str, np.ndarray], metadata: Mapping[str, Any], where: str) -> None:
        """Returns to the state that `tensors` and `metadata` described.

        Raises:
            InputError: a tensor or an entry is missing or does not fit; the message begins with `where`.
        """
        restore_adam(self._adam, PREFIX, tensors, where)
        try:
            self._rng.bit_generator.state = metadata["random"]
            self.steps, self.seconds = int(metadata["steps"]), float(metadata["seconds"])
            self.error = float("nan") if metadata["error"] is None else float(metadata["error"])
            self.history = [(int(step), float(seconds), float(error))
                            for step, seconds, error in metadata["history"]]
            self._guard.rate_factor = float(metadata["rate_factor"])
            self._guard.steps_refused = int(metadata["refused"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(where, f"metadata that is not a training state's ({error})",
                             "what a checkpoint writes") from None
        self._guard.snapshot()

    def _set_rates(self) -> float:
        """Sets the learning rates; returns the largest."""
        schedule = self.schedule
        progress = self.steps / schedule.decay_steps if schedule.decay_steps else self.done
        rate = schedule.learning_rate * schedule.decay**progress * self._guard.rate_factor
        rates = {name: rate * factor for name, factor in self._factors.items()}
        self._adam.set_learning_rate(rates)
        return max(rates.values())
