"""Fields that a study trains for itself: made, gone on with, or found finished in a folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.learn.loop import expect_capture, resume, start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run


def trained(folder: Path, capture: Capture, preset: Preset, options: TrainingOptions, begin: Callable[[], None]) -> Run:
    """The run in a folder, trained to its end: nothing is done where it is, a stopped one goes on, and a missing one is begun.

    Args:
        begin: called before training begins or goes on.

    Raises:
        KeyboardInterrupt: stopped by a signal; the next call goes on.
    """
    trainer = None
    if (folder / "config.json").exists():
        run = Run.load(folder)
        if run.config.get("trained", {}).get("done"):
            return run
        trainer = resume(folder, capture) if (folder / "state.safetensors").exists() else None
    if trainer is None:
        # A run without a training state was stopped before its first checkpoint: nothing of it is worth keeping.
        for file in (folder / "config.json", folder / "metrics.jsonl", *folder.glob("events.*")):
            file.unlink(missing_ok=True)
        trainer = start(folder, capture, preset, options)
    begin()
    train(trainer)
    return trainer.run


def expect_options(run: Run, capture: Capture, preset: Preset, options: TrainingOptions) -> None:
    """Raises InputError unless the run is of these options and of the capture."""
    expect_capture(run, capture)
    # All fields: dictionaries of presets leave out what older ones lack.
    had_preset, had_options = _parsed(run.config, f"{run.path / 'config.json'}: ")
    for key, have, want in (("preset", dataclasses.asdict(had_preset), dataclasses.asdict(preset)),
                            ("training", dataclasses.asdict(had_options), dataclasses.asdict(options))):
        other = sorted(option for option in want if have[option] != want[option])
        if other:
            raise InputError(f"{run.path / 'config.json'}: {key}", f"{other[0]} = {have[other[0]]!r}",
                             f"{want[other[0]]!r}, as asked for now",
                             "Give the options that it was started with, or take another folder.")


def read_options_of(document: dict[str, Any], where: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Preset and training options of a document with both, an option that did not exist when it was written at its value of then.

    Raises:
        InputError: either is missing or wrong; `where` and the key are in front.
    """
    preset, options = _parsed(document, where)
    return preset.to_dict(), options.to_dict()


def _parsed(document: dict[str, Any], where: str) -> tuple[Preset, TrainingOptions]:
    for key in ("preset", "training"):
        if not isinstance(document.get(key), dict):
            raise InputError(f"{where}{key}", repr(document.get(key)), "the options that it was started with")
    return Preset.from_dict(document["preset"], f"{where}preset"), TrainingOptions.from_dict(document["training"], f"{where}training")
