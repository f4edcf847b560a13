"""A whole training, new or resumed: progress bar, metrics, TensorBoard, checkpoints and signals."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

import drjit as dr
import mitsuba as mi
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

import ndf_mi
from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.learn.board import Board
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.prepare import Reference, planned, record, reference, with_bands
from ndf_mi.learn.scattering import check_integrator
from ndf_mi.learn.signals import Signals
from ndf_mi.learn.trainer import STATE, Trainer
from ndf_mi.run import SURFACE, Run
from ndf_mi.training_log import FILE_NAME as LOG

_LOG_EVERY = 50


def start(path: str | os.PathLike[str], capture: Capture, preset: Preset | None, options: TrainingOptions,
          plan: dict[str, Any] | None = None, surface: Reference | None = None,
          spent: float = 0.0) -> Trainer:
    """Creates a run in a new or empty folder.

    Args:
        path: the folder.
        capture: what to train on.
        preset: architecture; None plans it.
        options: training.
        plan: the plan that the preset comes from, as JSON values, to be recorded in the run's `config.json`.
        surface: the reference surface; None makes the one that the options ask for.
        spent: seconds that planning took; they and those of the surface count as training.

    Raises:
        InputError: the folder is not empty, the integrator does not exist, or the capture cannot be trained
            on with it. Nothing is written then.
    """
    check_integrator(options.integrator)
    expect_new(path)
    surface = surface or reference(capture, options)
    if preset is None:
        found = planned(capture, surface)
        preset, plan, spent = found.plan.preset, found.plan.to_dict(), spent + found.seconds
        surface = with_bands(surface, found.plan.bands, preset, preset, options)
    run = Run.create(
        path, preset, surface.body, surface.poses, options.seed, surface.tensors,
        background=[float(v) for v in capture.background],
        capture={"name": capture.name, "digest": capture.digest},
        training=options.to_dict(),
        **({} if plan is None else {"plan": plan}),
        **record(surface),
        made_by={"ndf_mi": ndf_mi.__version__, "mitsuba": mi.__version__, "drjit": dr.__version__,
                 "python": platform.python_version(), "variant": mi.variant()},
    )
    trainer = Trainer(run, capture, options, spent + surface.seconds)
    run.save()
    return trainer


def expect_new(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless a run can be started in this folder: it is new or empty."""
    folder = Path(path)
    # What a run holds that was killed while it was first written: config.json comes last.
    unfinished = {"body.npz", "poses.npz", "field.safetensors", SURFACE}
    if folder.exists() and (not folder.is_dir()
                            or {file.name
                                for file in folder.iterdir() if not files.is_left_over(file)} - unfinished):
        raise InputError(folder, "something there already", "a new or empty folder",
                         "Continue the run that is there with --resume, or choose another folder.")


def resume(path: str | os.PathLike[str], capture: Capture) -> Trainer:
    """Loads a run at its last checkpoint, with the options that it was started with.

    Raises:
        InputError: there is no run, it was trained on another capture, or its state cannot be read.
    """
    run = Run.load(path)
    config = run.path / "config.json"
    expect_capture(run, capture)
    training = run.config.get("training")
    if not isinstance(training, dict):
        raise InputError(f"{config}: training", repr(training), "the options that it was started with")
    options = TrainingOptions.from_dict(training, f"{config}: training")
    check_integrator(options.integrator)
    trainer = Trainer(run, capture, options)
    if (run.path / STATE).exists():
        trainer.restore()
    elif (run.path / LOG).exists():
        raise InputError(run.path / STATE, "no such file", "the training state to resume from",
                         "The run can be rendered but not trained further: start another.")
    _truncate_log(run.path / LOG, trainer.progress.step)
    return trainer


def expect_capture(run: Run, capture: Capture) -> None:
    """Raises InputError unless `run` was trained on `capture`."""
    known = run.config.get("capture")
    known = known if isinstance(known, dict) else {}
    if known.get("digest") != capture.digest:
        raise InputError(
            capture.path, f"the capture {capture.name!r} (digest {capture.digest[:12]})",
            f"the capture that {run.path} was trained on, {known.get('name')!r} (digest "
            f"{str(known.get('digest'))[:12]})")


def train(trainer: Trainer, quiet: bool = False,
          progress: Callable[[float, int, float], None] | None = None) -> None:
    """Trains to the end, or until SIGINT or SIGTERM.

    A signal lets the present step finish, saves the state and raises KeyboardInterrupt. If too many steps are
    refused, the last good state is saved. After any other error the last checkpoint remains.

    Args:
        trainer: new or resumed.
        quiet: shows no progress bar, and does not report that TensorBoard is missing.
        progress: called after each step taken with the seconds and steps so far and the smoothed mean squared
            error in sRGB.

    Raises:
        KeyboardInterrupt: a signal arrived.
        InputError: too many steps were refused because they were not finite.
    """
    folder = trainer.run.path
    last_save = time.perf_counter()
    board = Board(folder, trainer.progress.step, quiet)
    try:
        with Signals() as signals, _bar(quiet) as bar, open(folder / LOG, "a") as log:
            task = bar.add_task("training", total=1.0, psnr="")
            bar.update(task, completed=trainer.done)
            while trainer.done < 1 and not signals.received:
                taken = trainer.progress.step
                try:
                    trainer.step()
                except InputError as error:
                    _finish(trainer)
                    raise InputError(
                        error.where, error.found, error.expected,
                        f"{error.repair} The last good state is in {folder}: it can be rendered, and "
                        "--resume continues from it with the reduced rates.".lstrip()) from error
                now = trainer.progress
                if now.step == taken:
                    print(f"step {taken + 1} refused: its loss, gradients or parameters were not finite; "
                          f"continuing from the last good state with learning rates × {now.rate_factor:g}",
                          flush=True)
                    continue
                if progress is not None:
                    progress(now.seconds, now.step, now.error)
                if now.step % _LOG_EVERY == 0 or trainer.done >= 1:
                    _log(log, board, trainer)
                    psnr = f"step {now.step}  {now.psnr:.2f} dB"
                    if now.held_back_psnr is not None:
                        psnr += f"  held back {now.held_back_psnr:.2f} dB"
                    bar.update(task, completed=trainer.done, psnr=psnr)
                if time.perf_counter() - last_save > trainer.options.checkpoint_seconds:
                    trainer.save()
                    last_save = time.perf_counter()
        _finish(trainer)
    finally:
        board.close()
    if signals.received:
        raise KeyboardInterrupt


def _finish(trainer: Trainer) -> None:
    """Saves the state, and in `config.json` how far the training came."""
    trainer.save()
    run, now = trainer.run, trainer.progress
    run.config["trained"] = {"steps": now.step, "seconds": now.seconds, "done": trainer.done >= 1}
    if now.kept_step is not None and now.kept_psnr is not None:
        run.config["trained"]["kept"] = {"step": now.kept_step, "held_back_psnr": round(now.kept_psnr, 4)}
    if now.released:
        run.config["trained"]["all_views_from"] = now.held_back_step
    files.write_json(run.path / "config.json", run.config)


def _bar(quiet: bool) -> Progress:
    """A progress bar with the time remaining; hidden where standard error is no terminal."""
    return Progress(TextColumn("training"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"),
                    TextColumn("{task.fields[psnr]}"), TimeElapsedColumn(), TimeRemainingColumn(),
                    disable=quiet or not sys.stderr.isatty())


def _log(log: TextIO, board: Board, trainer: Trainer) -> None:
    now = trainer.progress
    row = {"step": now.step, "seconds": round(now.seconds, 3), "loss": now.error, "psnr": round(now.psnr, 4),
           "samples": now.evaluated}
    if now.box_psnr is not None:
        row["box_psnr"] = round(now.box_psnr, 4)
    if now.held_back_psnr is not None and now.held_back_step == now.step:
        row["held_back_psnr"] = round(now.held_back_psnr, 4)
        board.scalar("held_back/psnr", row["held_back_psnr"], now.step)
    if now.steps_refused:
        row |= {"refused": now.steps_refused, "rate_factor": now.rate_factor}
    print(json.dumps(row), file=log, flush=True)
    for name in ("loss", "psnr", "samples"):
        board.scalar(f"training/{name}", row[name], now.step)


def _truncate_log(path: Path, step: int) -> None:
    """Drops rows after `step`: the steps after the last checkpoint will be taken again."""
    if not path.exists():
        return
    kept = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            if json.loads(line)["step"] <= step:
                kept.append(line)
        except (ValueError, KeyError, TypeError):
            continue
    files.write_text(path, "".join(line + "\n" for line in kept))
