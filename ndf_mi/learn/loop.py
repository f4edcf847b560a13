"""A whole training: new or resumed, with a progress bar, logs, TensorBoard and checkpoints."""

from __future__ import annotations

import json
import math
import os
import platform
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any, TextIO

import drjit as dr
import mitsuba as mi
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

import ndf_mi
from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.learn.board import Board
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import QUADRATURE, ScatteringTrainer, check_integrator
from ndf_mi.learn.trainer import STATE, Trainer
from ndf_mi.run import Run

_LOG_EVERY = 50


def start(path: str | os.PathLike[str], capture: Capture, preset: Preset, options: TrainingOptions,
          plan: dict[str, Any] | None = None) -> Trainer:
    """A new run in a folder that does not exist yet or is empty.

    Args:
        path: the folder.
        capture: what to learn from.
        preset, options: architecture and training.
        plan: what the preset follows from, as JSON values, for the run's `config.json`.

    Raises:
        InputError: the folder holds something; there is no such integrator, or it finds no light in the capture. Nothing is written then.
    """
    check_integrator(options.integrator)
    folder = Path(path)
    # A run that was stopped while it was first written has no config.json yet.
    unfinished = {"body.npz", "poses.npz", "field.safetensors"}
    if folder.exists() and (not folder.is_dir()
                            or {file.name for file in folder.iterdir() if not files.is_left_over(file)} - unfinished):
        raise InputError(folder, "something there already", "a new or empty folder",
                         "Go on with what is there by --resume, or take another folder.")
    body = capture.body
    if options.atlas == "one-piece":
        from ndf_mi.body.atlas import with_one_piece

        body = with_one_piece(body, capture.poses.vertices[0] if body.template is None else None)
    run = Run.create(
        folder, preset, body, capture.poses, options.seed,
        background=[float(v) for v in capture.background],
        capture={"name": capture.name, "digest": capture.digest},
        training=options.to_dict(),
        **({} if plan is None else {"plan": plan}),
        made_by={"ndf_mi": ndf_mi.__version__, "mitsuba": mi.__version__, "drjit": dr.__version__, "python": platform.python_version(),
                 "variant": mi.variant()},
    )
    trainer = _trainer(run, capture, options)
    run.save()
    return trainer


def _trainer(run: Run, capture: Capture, options: TrainingOptions) -> Trainer:
    return (Trainer if options.integrator == QUADRATURE else ScatteringTrainer)(run, capture, options)


def resume(path: str | os.PathLike[str], capture: Capture) -> Trainer:
    """The run in a folder, at its last checkpoint, with the options it was started with.

    Raises:
        InputError: there is no run, it was trained on another capture, or its state cannot be read.
    """
    run = Run.load(path)
    config = run.path / "config.json"
    expect_capture(run, capture)
    training = run.config.get("training")
    if not isinstance(training, dict):
        raise InputError(f"{config}: training", repr(training), "the options it was started with")
    options = TrainingOptions.from_dict(training, f"{config}: training")
    check_integrator(options.integrator)
    trainer = _trainer(run, capture, options)
    if (run.path / STATE).exists():
        trainer.restore()
    elif (run.path / "metrics.jsonl").exists():
        raise InputError(run.path / STATE, "no such file", "the training state to go on from",
                         "The run can be rendered, but not trained further: start another.")
    _truncate_log(run.path / "metrics.jsonl", trainer.progress.step)
    return trainer


def expect_capture(run: Run, capture: Capture) -> None:
    """Raises InputError unless `run` was trained on `capture`."""
    known = run.config.get("capture")
    known = known if isinstance(known, dict) else {}
    if known.get("digest") != capture.digest:
        raise InputError(capture.path, f"the capture {capture.name!r} (digest {capture.digest[:12]})",
                         f"the one that {run.path} was trained on, {known.get('name')!r} (digest {str(known.get('digest'))[:12]})")


def train(trainer: Trainer, quiet: bool = False) -> None:
    """Trains to the end, or until SIGINT or SIGTERM: then the step under way is finished, the state saved, and KeyboardInterrupt
    raised. Where training is given up, the last state from which a step was sound is saved. Whatever else goes wrong, the last
    checkpoint stays.

    Raises:
        KeyboardInterrupt: stopped by a signal.
        InputError: steps were refused time and again because their gradients were not finite.
    """
    folder = trainer.run.path
    options = trainer.options
    saved = time.perf_counter()
    columns = (TextColumn("training"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"), TextColumn("{task.fields[facts]}"),
               TimeElapsedColumn(), TextColumn("{task.fields[left]}"))
    board = Board(folder, trainer.progress.step, quiet)
    try:
        hidden = quiet or not sys.stderr.isatty()
        with _Signals() as signals, Progress(*columns, disable=hidden) as bar, open(folder / "metrics.jsonl", "a") as log:
            task = bar.add_task("training", total=1.0, facts="", left="")
            bar.update(task, completed=trainer.done)
            begun, begun_at = trainer.done, time.perf_counter()
            while trainer.done < 1 and not signals.received:
                taken = trainer.progress.step
                try:
                    trainer.step()
                except InputError as error:
                    _leave(trainer)
                    raise InputError(error.where, error.found, error.expected,
                                     f"{error.repair} The last good state is in {folder}: it can be rendered, and --resume "
                                     "goes on from it as slowly as it came to be.".lstrip()) from error
                now = trainer.progress
                if now.step == taken:
                    bar.console.print(f"step {now.step + 1} is not taken: its gradient, or the weights after it, would not be finite. "
                                      f"Going on from an earlier state at {now.rate_factor:g} of the learning rate")
                    continue
                if now.step % _LOG_EVERY == 0 or trainer.done >= 1:
                    _log(log, board, trainer)
                    rate = (trainer.done - begun) / (time.perf_counter() - begun_at)
                    left = (1 - trainer.done) / rate if rate > 0 else math.inf
                    bar.update(task, completed=trainer.done, facts=f"step {now.step}  {now.psnr:.2f} dB", left=f"{left:.0f} s left")
                if time.perf_counter() - saved > options.checkpoint_seconds:
                    trainer.save()
                    saved = time.perf_counter()
        _leave(trainer)
    finally:
        board.close()
    if signals.received:
        raise KeyboardInterrupt


def _leave(trainer: Trainer) -> None:
    """Saves the state, and how far it has come."""
    trainer.save()
    run, now = trainer.run, trainer.progress
    run.config["trained"] = {"steps": now.step, "seconds": now.seconds, "done": trainer.done >= 1}
    files.write_json(run.path / "config.json", run.config)


class _Signals:
    """Notes SIGINT and SIGTERM while in its block, in place of their usual effect. A second one has its usual effect."""

    def __init__(self) -> None:
        self.received = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, _frame: object) -> None:
        self.received = True
        signal.signal(number, self._before[number])


def _log(log: TextIO, board: Board, trainer: Trainer) -> None:
    now = trainer.progress
    row = {"step": now.step, "seconds": round(now.seconds, 3), "loss": now.error, "psnr": round(now.psnr, 4), "samples": now.evaluated}
    if now.box_psnr is not None:
        row["box_psnr"] = round(now.box_psnr, 4)
    if now.refused:
        row |= {"refused": now.refused, "rate_factor": now.rate_factor}
    print(json.dumps(row), file=log, flush=True)
    for name in ("loss", "psnr", "samples"):
        board.scalar(f"training/{name}", row[name], now.step)


def _truncate_log(path: Path, step: int) -> None:
    """Drops logged steps beyond `step`: those after the last checkpoint are taken again."""
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
