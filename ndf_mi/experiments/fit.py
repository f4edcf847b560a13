"""Trainings as units of work: of a method, or of a run with given options."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.core import Progress, Unit, run_units
from ndf_mi.experiments.records import Trained
from ndf_mi.experiments.resources import peak_memory
from ndf_mi.experiments.store import Store
from ndf_mi.field import Preset
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.trained import trained as trained_run
from ndf_mi.methods.base import Budget, Configured, Resumable, Trainable

M = TypeVar("M", bound=Trainable)


def fitted(
    method: M, name: str, label: str, options: Mapping[str, Any], capture: Capture, budget: Budget,
    folder: Path, store: Store, progress: Progress,
) -> M:
    """The method, trained and saved, or loaded where it has been trained with the same inputs. The training
    of a `Resumable` continues where it stopped.

    Args:
        method: neither trained nor loaded yet.
        name: the method's name in the study.
        label: what progress reports call the training.
        options: those that it was created with, without what other trainings have found.
        capture: what it is trained on.
        budget: how long.
        folder: where it is saved.
        store: where the training is recorded.
        progress: receives the steps.
    """

    steps = 0

    def report(seconds: float, step: int, loss: float) -> None:
        nonlocal steps
        steps += 1
        progress.training(label, seconds, budget.seconds, step, loss)

    def train() -> None:
        if isinstance(method, Resumable):
            method.fit_in(folder, capture, budget, report)
        else:
            method.fit(capture, budget, report)
            method.save(folder)

    def work() -> Trained:
        peak = peak_memory(train)
        if not steps and key in (known := store.matching(key, Trained)):
            peak = known[key].peak_memory  # It was only loaded.
        return Trained(method.metadata(), peak)

    key = f"{name}/train"
    inputs: dict[str, Any] = {
        "capture": capture.digest, "method": method.key, "options": dict(options), "seed": budget.seed,
        "budget": budget.seconds,
    }
    if isinstance(method, Configured):
        inputs["settings"] = method.training_settings()
    unit = Unit(key, inputs, work, Trained, (folder,), label)
    if store.fresh(unit) is None:
        run_units([unit], store, progress)
    else:
        method.load(folder, capture)
    return method


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
