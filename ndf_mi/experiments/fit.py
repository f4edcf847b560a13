"""Trainings as units of work: of a method, or of a run with given options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.core import Progress, Unit
from ndf_mi.experiments.records import Trained
from ndf_mi.field import Preset
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.trained import trained as trained_run
from ndf_mi.methods.base import Budget, Resumable, Trainable

M = TypeVar("M", bound=Trainable)


def fit_unit(
    name: str, label: str, method: M, options: Mapping[str, Any], capture: Capture, budget: Budget,
    folder: Path, progress: Progress,
) -> tuple[Unit[Trained], Callable[[], M]]:
    """A unit that trains a method and saves it; the training of a `Resumable` continues where it stopped.

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
        def report(seconds: float, step: int, loss: float) -> None:
            progress.training(label, seconds, budget.seconds, step, loss)

        if isinstance(method, Resumable):
            method.fit_in(folder, capture, budget, report)
        else:
            method.fit(capture, budget, report)
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


def training_unit(
    name: str, label: str, folder: Path, capture: Capture, preset: Preset, options: TrainingOptions
) -> Unit[Trained]:
    """A unit that trains the run in a folder to its end; a stopped training continues."""

    def work() -> Trained:
        run = trained_run(folder, capture, preset, options)
        return Trained({key: run.config.get("trained", {}).get(key) for key in ("steps", "seconds")})

    inputs = {"capture": capture.digest, "preset": preset.to_dict(), "training": options.to_dict()}
    outputs = (folder / "config.json", folder / "field.safetensors")
    return Unit(f"{name}/train", inputs, work, Trained, outputs, label, "train")
