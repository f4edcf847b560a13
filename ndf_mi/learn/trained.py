"""Runs that another program trains to their end: started, or continued where they stopped."""

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
from ndf_mi.learn.refinement import INITIAL
from ndf_mi.learn.trainer import STATE
from ndf_mi.run import Run
from ndf_mi.training_log import FILE_NAME as LOG


def is_trained(folder: Path) -> bool:
    """Whether a folder holds a run that was trained to its end."""
    return (folder / "config.json").exists() and bool(Run.load(folder).config.get("trained", {}).get("done"))


def trained(folder: Path, capture: Capture, preset: Preset | None, options: TrainingOptions,
            quiet: bool = False, progress: Callable[[float, int, float], None] | None = None) -> Run:
    """The run in a folder, trained to its end. A finished run is loaded, a stopped one continues with its own
    options, and a missing one is started.

    Args:
        preset: architecture; None plans it.
        quiet, progress: as for `train`.

    Raises:
        KeyboardInterrupt: stopped by a signal; the next call continues.
    """
    if is_trained(folder):
        return Run.load(folder)
    if (folder / "config.json").exists() and (folder / STATE).exists():
        trainer = resume(folder, capture)
    else:
        # A run without a training state was stopped before its first checkpoint: nothing of it is worth
        # keeping.
        clear(folder)
        trainer = start(folder, capture, preset, options)
    train(trainer, quiet, progress)
    return trainer.run


def clear(folder: Path) -> None:
    """Deletes what would keep `start` from creating a run in a folder that holds one."""
    for file in (folder / "config.json", folder / STATE, folder / LOG, folder / INITIAL,
                 *folder.glob("events.*")):
        file.unlink(missing_ok=True)


def expect_options(run: Run, capture: Capture, preset: Preset | None, options: TrainingOptions) -> None:
    """Raises InputError unless the run has these options and was trained on the capture. Without a preset,
    the run must have been planned."""
    expect_capture(run, capture)
    # Compared field by field: dictionaries of presets omit fields that older versions did not have.
    had = read_options(run.config, f"{run.path / 'config.json'}: ")
    if preset is None:
        if "plan" not in run.config:
            raise InputError(f"{run.path / 'config.json'}: plan", "nothing", "the plan of its architecture",
                             "Use another folder.")
        preset = had[0]
    for key, before, now in (("preset", had[0], preset), ("training", had[1], options)):
        have, want = dataclasses.asdict(before), dataclasses.asdict(now)
        other = sorted(option for option in want if have[option] != want[option])
        if other:
            found, asked = (", ".join(f"{name} = {values[name]!r}" for name in other)
                            for values in (have, want))
            raise InputError(f"{run.path / 'config.json'}: {key}", found, f"{asked}, as asked for",
                             "Give the options that the run was started with, or use another folder.")


def read_options(document: dict[str, Any], where: str) -> tuple[Preset, TrainingOptions]:
    """Preset and training options of a run's configuration; options that are newer than the run have their
    former value.

    Raises:
        InputError: either is missing or invalid; the message begins with `where` and the key.
    """
    for key in ("preset", "training"):
        if not isinstance(document.get(key), dict):
            raise InputError(f"{where}{key}", repr(document.get(key)),
                             "the options that the run was started with")
    return (Preset.from_dict(document["preset"], f"{where}preset"),
            TrainingOptions.from_dict(document["training"], f"{where}training"))
