"""How a surface fit is trained: for a given time, for a number of steps, until the loss stops falling;
searches of rates.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

Progress = Callable[[float, int, float], None]
"""Called after a step with the seconds and steps so far and the step's loss."""


class Fit(Protocol):
    """Something that is optimised step by step.

    Attributes:
        frames: steps in a pass over the training frames.
    """

    frames: int

    def step(self, number: int) -> float:
        """Takes step `number`, from 0 on, and returns its loss."""
        ...

    def set_rate(self, factor: float) -> None:
        """Sets all learning rates to `factor` of their first values, from the next step on."""
        ...


@dataclass(frozen=True)
class Schedule:
    """When rates fall and when training ends.

    Attributes:
        final_rate: factor of the rates at the end of a training of given length; they decay exponentially.
        window_steps: fewest steps in a window. Windows hold whole passes over the frames, so that their means
            compare.
        tolerance: a window whose mean loss is not lower than the best one by this share is a plateau.
        drops: how many plateaus lower the rates; at the next one the training has converged.
        drop: factor of the rates at a plateau.
        max_steps: limit of a training to convergence.
        search_frames, search_steps: training frames and steps for each rate of a search.
        texture_rates: Adam's learning rates of a texture that a search tries, in sRGB units.
        offset_rates: first steps of offsets that a search tries, metres. Its few steps would favour larger
            ones: it would choose 0.1, which ended 0.7 dB below 0.03 after a training of 280 steps on the
            capture `quick`.
    """

    final_rate: float = 0.03
    window_steps: int = 50
    tolerance: float = 5e-3
    drops: int = 3
    drop: float = 10**-0.5
    max_steps: int = 8000
    search_frames: int = 5
    search_steps: int = 40
    texture_rates: tuple[float, ...] = (3e-3, 1e-2, 3e-2, 1e-1, 3e-1)
    offset_rates: tuple[float, ...] = (1e-2, 2e-2, 4e-2)


DEFAULT = Schedule()
"""The schedule of every fit that is given none."""


@dataclass
class Training:
    """How a training went.

    Attributes:
        seconds, steps: wall-clock seconds and steps.
        converged: whether it ended because the loss stopped falling.
        history: (step, seconds, loss), means over windows.
    """

    seconds: float = 0.0
    steps: int = 0
    converged: bool = False
    history: list[tuple[int, float, float]] = field(default_factory=list)


@dataclass(frozen=True)
class Search:
    """A learning rate, and how it was found.

    Attributes:
        rate: the rate.
        losses: training loss that each rate tried had reached, keyed by the rate as text; empty if the rate
            was given.
        seconds: wall-clock seconds that the search took.
    """

    rate: float
    losses: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0


def train(fit: Fit, schedule: Schedule, seconds: float | None = None,
          progress: Progress | None = None) -> Training:
    """Trains for some time, at least one step, while the rates decay; or until the loss stops falling.

    Args:
        fit: freshly made.
        schedule: when rates fall and when training ends.
        seconds: wall-clock seconds; None trains to convergence, lowering the rates at plateaus.
        progress: called after each step.
    """
    start = time.perf_counter()
    length = -(-schedule.window_steps // fit.frames) * fit.frames
    training, losses = Training(), list[float]()
    factor, best, drops = 1.0, np.inf, 0
    fit.set_rate(factor)
    while not training.steps or (training.steps < schedule.max_steps if seconds is None
                                 else time.perf_counter() - start < seconds):
        if seconds:
            fit.set_rate(schedule.final_rate ** min((time.perf_counter() - start) / seconds, 1))
        loss = fit.step(training.steps)
        training.steps, training.seconds = training.steps + 1, time.perf_counter() - start
        if progress is not None:
            progress(training.seconds, training.steps, loss)
        losses.append(loss)
        if len(losses) < length:
            continue
        mean = float(np.mean(losses))
        losses.clear()
        training.history.append((training.steps, training.seconds, mean))
        if seconds is None and mean > best * (1 - schedule.tolerance):
            drops += 1
            if drops > schedule.drops:
                training.converged = True
                break
            factor *= schedule.drop
            fit.set_rate(factor)
        best = min(best, mean)
    return training


def train_steps(fit: Fit, schedule: Schedule, steps: int) -> float:
    """Trains for a number of steps while the rates decay; returns the mean loss over the last pass."""
    losses = []
    for number in range(steps):
        fit.set_rate(schedule.final_rate ** (number / steps))
        losses.append(fit.step(number))
    return float(np.mean(losses[-fit.frames :]))


def search(make: Callable[[float], Fit], rates: Sequence[float], schedule: Schedule) -> Search:
    """The rate with the lowest loss after a few steps.

    Args:
        make: a fresh fit with that rate, on the frames of `search_frames`.
        rates: those to try.
        schedule: the number of steps.
    """
    start = time.perf_counter()
    losses = {rate: train_steps(make(rate), schedule, schedule.search_steps) for rate in rates}
    best = min(losses, key=lambda rate: losses[rate])
    return Search(best, {f"{rate:g}": loss for rate, loss in losses.items()}, time.perf_counter() - start)


def search_frames(frames: Sequence[int], schedule: Schedule) -> list[int]:
    """The training frames of a search, spread evenly; all if there are no more."""
    if not frames:
        return []
    chosen = np.linspace(0, len(frames) - 1, schedule.search_frames).round().astype(int)
    return [frames[i] for i in np.unique(chosen)]
