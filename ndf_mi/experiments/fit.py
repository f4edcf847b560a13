"""Training a method as a unit of work."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.core import Progress, Unit
from ndf_mi.experiments.records import Trained
from ndf_mi.methods.base import Budget, Trainable

M = TypeVar("M", bound=Trainable)


def fit_unit(
    name: str, label: str, method: M, options: Mapping[str, Any], capture: Capture, budget: Budget,
    folder: Path, progress: Progress,
) -> tuple[Unit[Trained], Callable[[], M]]:
    """A unit that trains a method and saves it.

    Args:
        name: the method's name in the study.
        label: what progress reports call the training.
        method: neither trained nor loaded yet.
        options: those that it was created with, without what other trainings have found.
        capture: what it is trained on.
        budget: how long.
        folder: where it is saved.
        progress: receives the steps.

    Returns:
        the unit; and a function that returns the method, ready to render, once the unit's record is fresh.
    """
    ready: list[M] = []

    def work() -> Trained:
        method.fit(
            capture, budget,
            lambda seconds, step, loss: progress.training(label, seconds, budget.seconds, step, loss),
        )
        method.save(folder)
        ready.append(method)
        return Trained(method.metadata())

    def trained() -> M:
        if not ready:
            method.load(folder, capture)
            ready.append(method)
        return method

    inputs = {
        "capture": capture.digest, "method": method.key, "options": dict(options), "seed": budget.seed,
        "budget": budget.seconds,
    }
    return Unit(f"{name}/train", inputs, work, Trained, (folder,), label), trained
