"""Fields that a study trains: each is a run in a folder of the study."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.experiments.core import Unit
from ndf_mi.experiments.records import Trained
from ndf_mi.field import Preset
from ndf_mi.learn.loop import expect_capture, resume, start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run


def training_unit(
    name: str, label: str, folder: Path, capture: Capture, preset: Preset, options: TrainingOptions
) -> Unit[Trained]:
    """A unit that trains the run in a folder to its end; a stopped training continues."""

    def work() -> Trained:
        run = trained(folder, capture, preset, options)
        return Trained({key: run.config.get("trained", {}).get(key) for key in ("steps", "seconds")})

    inputs = {"capture": capture.digest, "preset": preset.to_dict(), "training": options.to_dict()}
    return Unit(
        f"{name}/train", inputs, work, Trained, (folder / "config.json", folder / "field.safetensors"), label,
        "train",
    )


def is_trained(folder: Path) -> bool:
    """Whether a folder holds a run that was trained to its end."""
    return (folder / "config.json").exists() and bool(Run.load(folder).config.get("trained", {}).get("done"))


def trained(folder: Path, capture: Capture, preset: Preset, options: TrainingOptions) -> Run:
    """The run in a folder, trained to its end. A finished run is loaded, a stopped one continues, and a
    missing one is started.

    Raises:
        KeyboardInterrupt: stopped by a signal; the next call continues.
    """
    trainer = None
    if is_trained(folder):
        return Run.load(folder)
    if (folder / "config.json").exists() and (folder / "state.safetensors").exists():
        trainer = resume(folder, capture)
    if trainer is None:
        # A run without a training state was stopped before its first checkpoint: nothing of it is worth
        # keeping.
        for file in (folder / "config.json", folder / "metrics.jsonl", *folder.glob("events.*")):
            file.unlink(missing_ok=True)
        trainer = start(folder, capture, preset, options)
    train(trainer)
    return trainer.run


def expect_options(run: Run, capture: Capture, preset: Preset, options: TrainingOptions) -> None:
    """Raises InputError unless the run has these options and was trained on the capture."""
    expect_capture(run, capture)
    # Compared field by field: dictionaries of presets omit fields that older versions did not have.
    had_preset, had_options = read_options(run.config, f"{run.path / 'config.json'}: ")
    for key, have, want in (
        ("preset", dataclasses.asdict(had_preset), dataclasses.asdict(preset)),
        ("training", dataclasses.asdict(had_options), dataclasses.asdict(options)),
    ):
        other = sorted(option for option in want if have[option] != want[option])
        if other:
            raise InputError(
                f"{run.path / 'config.json'}: {key}", f"{other[0]} = {have[other[0]]!r}",
                f"{want[other[0]]!r}, the value asked for",
                "Give the options that the run was started with, or use another folder.",
            )


def read_options(document: dict[str, Any], where: str) -> tuple[Preset, TrainingOptions]:
    """Preset and training options of a run's configuration; options that are newer than the run have their
    former value.

    Raises:
        InputError: either is missing or invalid; the message begins with `where` and the key.
    """
    for key in ("preset", "training"):
        if not isinstance(document.get(key), dict):
            raise InputError(
                f"{where}{key}", repr(document.get(key)), "the options that the run was started with"
            )
    return Preset.from_dict(document["preset"], f"{where}preset"), TrainingOptions.from_dict(
        document["training"], f"{where}training"
    )
