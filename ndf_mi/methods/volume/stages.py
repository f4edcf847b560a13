"""A training in stages, one after the other, each of tensors of its own; with checkpoints between steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from ndf_mi.learn.signals import Signals
from ndf_mi.learn.state import write_state
from ndf_mi.methods.base import Progress
from ndf_mi.methods.volume.optimisation import PREFIX, Objective, Optimisation, Schedule
from ndf_mi.methods.volume.record import Tensors, VolumeRecord, read_checkpoint
from ndf_mi.methods.volume.volume import Parameters

CHECKPOINT_SECONDS = 60.0


class FinalStage(Protocol):
    """What is trained after a volume has been trained on rays: other tensors, by an objective of their own,
    while the volume's stay.

    Attributes:
        share: of a budget's seconds, in (0, 1).
        schedule: rates and length.
        note: what the stage does, one sentence for the report.
    """

    share: float
    schedule: Schedule
    note: str

    def initial(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Flat float32 tensors to start from, by names that the volume's do not have."""
        ...

    def objective(self, parameters: Parameters) -> Objective:
        """The loss, given the volume's trained parameters."""
        ...


@dataclass
class Training:
    """A training of one or more stages. A stopped one continues in the stage where it was.

    Attributes:
        record: what is known of it; `run` keeps the seconds and refused steps up to date.
        tensors: what is finished, by name.
        file: where checkpoints are written, or None.
    """

    record: VolumeRecord
    tensors: Tensors
    file: Path | None
    _stopped: tuple[int, Tensors, dict[str, Any]] | None = field(default=None, repr=False)

    @classmethod
    def resumed(cls, file: Path, record: VolumeRecord) -> Training | None:
        """The stopped training like `record`'s that a file holds; None if there is none."""
        found = read_checkpoint(file, record)
        if found is None:
            return None
        tensors, metadata = found
        kept = {name: value for name, value in tensors.items() if not name.startswith(f"{PREFIX}.")}
        return cls(msgspec.convert(metadata["record"], VolumeRecord), kept, file,
                   (int(metadata["stage"]), tensors, metadata))

    def run(self, stage: int, initial: Mapping[str, np.ndarray], objective: Objective, schedule: Schedule,
            until: float | None, rates: Mapping[str, float] | None = None,
            progress: Progress | None = None) -> Optimisation | None:
        """Trains a stage to its end, or until SIGINT or SIGTERM. Its parameters then are among `tensors`.

        Args:
            stage: its number, from 0 on.
            initial, objective, schedule, rates: as for `Optimisation`.
            until: seconds of the whole training at which it ends; None takes the schedule's steps.
            progress: called after each step that is taken.

        Returns:
            the optimisation at its end; None for a stage that was finished before the training was stopped.

        Raises:
            KeyboardInterrupt: a signal arrived.
            InputError: too many steps were refused.
        """
        if self._stopped is not None and stage < self._stopped[0]:
            return None
        record = self.record
        optimisation = Optimisation(initial, objective, schedule, until, record.seed, rates, record.seconds)
        if self._stopped is not None and stage == self._stopped[0]:
            optimisation.restore(self._stopped[1], self._stopped[2], str(self.file))
        train(optimisation, progress, lambda: self._checkpoint(stage, optimisation))
        self.tensors |= {name: value.numpy() for name, value in optimisation.parameters.items()}
        record.seconds = round(optimisation.seconds, 3)
        record.refused += optimisation.steps_refused
        return optimisation

    def _checkpoint(self, stage: int, optimisation: Optimisation) -> None:
        if self.file is not None:
            metadata = {**optimisation.metadata(), "stage": stage,
                        "record": msgspec.to_builtins(self.record)}
            write_state(self.file, {**self.tensors, **optimisation.tensors()}, metadata)


def train(optimisation: Optimisation, progress: Progress | None, checkpoint: Callable[[], None]) -> None:
    """Trains to the end, or until SIGINT or SIGTERM.

    Args:
        optimisation: new or restored.
        progress: called after each step that is taken.
        checkpoint: called about once a minute, and when a signal has arrived.

    Raises:
        KeyboardInterrupt: a signal arrived.
        InputError: too many steps were refused.
    """
    saved = time.perf_counter()
    with Signals() as signals:
        while optimisation.done < 1 and not signals.received:
            taken = optimisation.steps
            optimisation.step()
            if progress is not None and optimisation.steps > taken:
                progress(optimisation.seconds, optimisation.steps, optimisation.error)
            if time.perf_counter() - saved > CHECKPOINT_SECONDS:
                checkpoint()
                saved = time.perf_counter()
    if signals.received:
        checkpoint()
        raise KeyboardInterrupt
