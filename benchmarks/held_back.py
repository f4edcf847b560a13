"""What held-back training views say of held-out images, step by step, and whether averaged weights are
better.

    python benchmarks/held_back.py captures/quick --steps 1500 --average 0.99 --average 0.998

Trains a field that never draws the held-back views, nor the pixels of scattered blocks of 8 × 8 in the other
views. Prints box PSNR in dB, of rays drawn once: of the held-back views, of the blocks, and of the held-out
splits; then the same of exponential moving averages of the parameters, one for each `--average`, which is the
weight of the past at each step. The last rows give the step that each column would keep, and what it has on
the held-out splits.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402

from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.commands.training_options import configured  # noqa: E402
from ndf_mi.field import FieldParameters  # noqa: E402
from ndf_mi.learn.batch import Batch  # noqa: E402
from ndf_mi.learn.held_back import RAYS, choose_views, mean_error, view_rays  # noqa: E402
from ndf_mi.learn.loop import start  # noqa: E402
from ndf_mi.learn.options import TrainingOptions  # noqa: E402
from ndf_mi.learn.step import QuadratureStep  # noqa: E402
from ndf_mi.learn.trainer import Trainer  # noqa: E402

BLOCK = 8
"""Width of a block in pixels."""
EACH = 16
"""One block in so many is left out."""


@dataclass(frozen=True)
class Options:
    """What is trained and measured."""

    capture: Annotated[Path, tyro.conf.Positional]
    """The capture's folder."""

    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """NAME=VALUE, as for `ndf-mi optimise`."""

    average: Annotated[tuple[float, ...], tyro.conf.UseAppendAction] = ()
    """Weight of the past in a moving average of the parameters."""

    preset: str = "fast"
    """Architecture."""

    steps: int = 1500
    """Steps of the training."""

    moments: int = 20
    """How often it is measured."""

    seed: int = 0
    """Seed of the training and of the rays."""


def main(options: Options) -> None:
    """Trains, measures and prints."""
    capture = Capture.read(options.capture)
    preset, training = configured(options.preset, [*options.option, "held_back_until=1"],
                                  steps=options.steps, seed=options.seed)
    with tempfile.TemporaryDirectory() as folder:
        trainer = start(Path(folder) / "run", capture, preset, training)
        rays = ray_sets(trainer, capture, training)
        trainer.batches = without_blocks(trainer.batches, capture)
        step = QuadratureStep(trainer.run, training, None)
        averages = [(weight, trainer.parameters.detached()) for weight in options.average]
        columns = [f"{name}{suffix}" for suffix in ("", *(f", {weight:g}" for weight in options.average))
                   for name in rays]
        print("step | " + " | ".join(columns), flush=True)
        table, steps, seconds, measuring = [], [], [], []
        every = math.ceil(options.steps / options.moments)
        while trainer.done < 1:
            begun = time.perf_counter()
            trainer.step()
            dr.sync_thread()
            seconds.append(time.perf_counter() - begun)
            averages = [(weight, mixed(before, trainer.parameters.detached(), weight))
                        for weight, before in averages]
            taken = trainer.progress.step
            if taken % every and trainer.done < 1:
                continue
            begun = time.perf_counter()
            mean_error(rays["held-back views"], step.image_error, trainer.parameters)
            measuring.append(time.perf_counter() - begun)
            row = [-10 * math.log10(mean_error(batches, step.image_error, parameters))
                   for parameters in (trainer.parameters, *(average for _, average in averages))
                   for batches in rays.values()]
            table.append(row)
            steps.append(taken)
            print(f"{taken} | " + " | ".join(f"{value:.2f}" for value in row), flush=True)
    print(f"a step takes {np.median(seconds):.3f} s, rendering the held-back views "
          f"{np.median(measuring):.3f} s")
    report(columns, len(rays), np.array(table), steps)


def report(columns: list[str], width: int, table: np.ndarray, steps: list[int]) -> None:
    """Prints which step each column would keep, and the held-out figures then.

    Args:
        columns: names of the sets of rays, repeated for each average.
        width: number of sets; the first two are of training views.
        table: (moments, columns) in dB.
        steps: of the moments.
    """
    for first in range(0, len(columns), width):
        names = columns[first:first + width]
        rows = {name: int(table[:, first + index].argmax()) for index, name in enumerate(names)}
        for name, row in {**rows, "last": len(table) - 1}.items():
            held_out = zip(columns[first + 2:first + width], table[row, first + 2:first + width], strict=True)
            print(f"kept by {name}: step {steps[row]}, "
                  + ", ".join(f"{split} {value:.2f} dB" for split, value in held_out))


def ray_sets(trainer: Trainer, capture: Capture, training: TrainingOptions) -> dict[str, list[Batch]]:
    """Batches by name: of held-back views, of blocks in the other views, and of the held-out splits."""
    rng = np.random.default_rng(1)
    split = capture.splits["train"]
    held = choose_views(len(split.frames), len(split.cameras), training.held_back, training.seed)
    names = [(split.cameras[column], split.frames[row]) for row, column in held]
    others = [(camera, frame) for frame in split.frames for camera in split.cameras
              if (camera, frame) not in names]
    others = [others[i] for i in rng.permutation(len(others))[:12]]

    def drawn(views: list[tuple[str, int]], count: int) -> list[Batch]:
        return [view_rays(trainer.run, capture, training, camera, frame, count // len(views), rng)
                for camera, frame in views]

    sets = {"held-back views": drawn(names, RAYS),
            "blocks": [within(batch, in_block(capture, batch)) for batch in drawn(others, RAYS * EACH)]}
    for name in ("novel_view", "novel_pose"):
        views = [(camera, frame) for frame in capture.splits[name].frames
                 for camera in capture.splits[name].cameras]
        views = [views[i] for i in rng.permutation(len(views))[:12]]
        if views:
            sets[name.replace("_", " ") + "s"] = drawn(views, RAYS)
    return sets


def in_block(capture: Capture, batch: Batch) -> np.ndarray:
    """(R,) bool: whether each ray passes a pixel of a block that is left out."""
    cameras = [capture.cameras[name] for name in capture.splits["train"].cameras]
    eyes = np.array([camera.position for camera in cameras])
    column = np.square(batch.origin.T[:, None] - eyes).sum(-1).argmin(1)
    inside = np.zeros(len(column), bool)
    for index in np.unique(column):
        of = column == index
        pixels = cameras[index].project((batch.origin + 2 * batch.direction).T[of]) // BLOCK
        x, y = pixels.astype(int).T
        inside[of] = (x + 5 * y + 3 * batch.frame + 7 * index) % EACH == 0
    return inside


def within(batch: Batch, chosen: np.ndarray) -> Batch:
    """The chosen rays of a batch, (R,) bool or indices."""
    rays = {field.name: getattr(batch, field.name)[..., chosen] for field in fields(batch)
            if field.name in ("origin", "direction", "target", "mask", "mask_valid", "in_box", "camera")}
    jitter = batch.jitter.reshape(len(batch.in_box), -1)[chosen].ravel()
    return replace(batch, jitter=jitter, **rays)


def without_blocks(draw: Callable[..., Batch], capture: Capture) -> Callable[..., Batch]:
    """Batches whose rays in blocks are replaced by others of the same batch."""
    def drawn(rng: np.random.Generator, *arguments: bool) -> Batch:
        batch = draw(rng, *arguments)
        inside = in_block(capture, batch)
        index = np.arange(len(inside))
        index[inside] = rng.choice(index[~inside], int(inside.sum()))
        return within(batch, index)
    return drawn


def mixed(before: FieldParameters, now: FieldParameters, weight: float) -> FieldParameters:
    """weight · before + (1 − weight) · now."""
    def mean(one: object, other: object) -> object:
        return None if one is None else dr.lerp(other, one, weight)
    values = FieldParameters(mean(before.weights, now.weights), mean(before.grid, now.grid))
    dr.eval(values.weights, values.grid)
    return values


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
