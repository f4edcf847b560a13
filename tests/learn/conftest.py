"""Spoils chosen batches of a training."""

import dataclasses
import itertools
from collections.abc import Callable, Collection

import numpy as np
import pytest

from ndf_mi.learn.batch import Batch
from ndf_mi.learn.trainer import Trainer


@pytest.fixture
def poison() -> Callable[[Trainer, Collection[int]], list[bool]]:
    """Makes the targets of some of a trainer's batches NaN.

    Called with the trainer and the numbers of the batches, counted from 1; returns a list that grows with
    each batch by whether it is one through scattering.
    """

    def spoil(trainer: Trainer, numbers: Collection[int]) -> list[bool]:
        draw, count, drawn = trainer.batches, itertools.count(1), []

        def batches(rng: np.random.Generator, edge_active: bool, scattering: bool) -> Batch:
            batch = draw(rng, edge_active, scattering)
            drawn.append(scattering)
            if next(count) not in numbers:
                return batch
            return dataclasses.replace(batch, target=np.full_like(batch.target, np.nan))

        trainer.batches = batches
        return drawn

    return spoil
