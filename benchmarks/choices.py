"""What changes to the preset or the training options are worth on held-out images, and where the error is.

    python benchmarks/choices.py captures/studio --steps 1500 --choice samples=128 --choice "decay=0.02
    clip=8"

Trains a field without changes and one for each `--choice`, all with one seed. A choice is one or more
NAME=VALUE, as for `ndf-mi optimise --option`. Renders each field in the same held-out images. Box PSNR and
SSIM are means over the images. The mean squared error, in 1e-4, is the sum of its parts at the silhouette's
edge (pixels whose 3 × 3 neighbours hold both performer and background), within it, and outside it. Seconds a
step are the median of the last 300 and depend on the machine; the other figures do not.

With `--held-back` nothing held-out is rendered, so that options can be chosen without it: for each training
it prints the curve of box PSNR on held-back training views, `step: dB`, and the best of it. All trainings
hold back the same views.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from scipy import ndimage

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402

from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.commands.training_options import configured  # noqa: E402
from ndf_mi.errors import InputError  # noqa: E402
from ndf_mi.experiments import metrics  # noqa: E402
from ndf_mi.experiments.evaluate import choose_views  # noqa: E402
from ndf_mi.experiments.records import SPLITS, View  # noqa: E402
from ndf_mi.learn.loop import start  # noqa: E402
from ndf_mi.methods.ndf import NeuralField  # noqa: E402


@dataclass(frozen=True)
class Options:
    """What is trained and measured."""

    capture: Annotated[Path, tyro.conf.Positional]
    """The capture's folder."""

    choice: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Options of one training: NAME=VALUE, separated by spaces. Can be given several times."""

    preset: str = "fast"
    """Architecture."""

    steps: int = 1500
    """Steps of each training."""

    seed: int = 0
    """Seed of the trainings, and for choosing the images."""

    images: int = 12
    """Images of each held-out split."""

    samples: int = 128
    """Candidate samples a ray when rendered."""

    held_back: bool = False
    """Print the curve on held-back training views instead of held-out images."""


def main(options: Options) -> None:
    """Trains, measures and prints a table."""
    capture = Capture.read(options.capture)
    if options.held_back:
        print("| | kept step | held-back PSNR | curve |\n| --- | --- | --- | --- |", flush=True)
        for choice in ("", *options.choice):
            print(f"| {choice or 'unchanged'} | {held_back_row(capture, options, choice)} |", flush=True)
        return
    views = choose_views(capture, options.images, options.seed)
    splits = list(dict.fromkeys(view.split for view in views))
    heads = [f"{SPLITS[split]}: {name}" for split in splits
             for name in ("PSNR", "SSIM", "edge", "within", "outside")]
    print("| | s a step | samples | " + " | ".join(heads) + " |\n| --- |" + " --- |" * (len(heads) + 2),
          flush=True)
    for choice in ("", *options.choice):
        entries = tuple(choice.split())
        seconds, evaluated, method = trained(capture, options, entries)
        rows = np.array([measure(capture, view, method) for view in views])
        cells = []
        for split in splits:
            psnr, ssim, *errors = rows[[view.split == split for view in views]].mean(0)
            cells += [f"{psnr:.2f}", f"{ssim:.3f}", *(f"{1e4 * error:.2f}" for error in errors)]
        print(f"| {choice or 'unchanged'} | {seconds:.3f} | {evaluated:,} | " + " | ".join(cells) + " |",
              flush=True)


def held_back_row(capture: Capture, options: Options, choice: str) -> str:
    """Trains; returns the step that is kept, its PSNR on held-back views, and the curve, as a row's cells."""
    preset, training = configured(options.preset, [*choice.split(), "held_back_until=1"],
                                  steps=options.steps, seed=options.seed)
    curve = {}
    with tempfile.TemporaryDirectory() as folder:
        trainer = start(Path(folder) / "run", capture, preset, training)
        while trainer.done < 1:
            trainer.step()
            now = trainer.progress
            curve[now.held_back_step] = now.held_back_psnr
    if now.kept_step is None:
        raise InputError(options.capture, "too few views to hold any back", "a larger held_back")
    shown = ", ".join(f"{step}: {psnr:.2f}" for step, psnr in curve.items() if psnr is not None)
    return f"{now.kept_step} | {now.kept_psnr:.2f} | {shown}"


def trained(capture: Capture, options: Options, entries: tuple[str, ...]) -> tuple[float, int, NeuralField]:
    """Trains; returns median seconds of the last steps, samples evaluated by the last one, and the field."""
    preset, training = configured(options.preset, entries, steps=options.steps, seed=options.seed)
    with tempfile.TemporaryDirectory() as folder:
        trainer = start(Path(folder) / "run", capture, preset, training)
        seconds = []
        while trainer.done < 1:
            begun = time.perf_counter()
            trainer.step()
            dr.sync_thread()
            seconds.append(time.perf_counter() - begun)
        trainer.publish()
    field = NeuralField.of(trainer.run, options.samples)
    return float(np.median(seconds[-300:])), trainer.progress.evaluated, field


def measure(capture: Capture, view: View, method: NeuralField) -> tuple[float, ...]:
    """Box PSNR and SSIM of an image, and the parts of its mean squared error: edge, within and outside."""
    camera, truth = capture.cameras[view.camera], capture.image(view.camera, view.frame)
    image, mask = method.render(camera, view.frame), capture.mask(view.camera, view.frame)
    box = metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])
    figures = metrics.measure(truth, image, box)
    around = np.ones((3, 3), bool)
    edge = ndimage.binary_dilation(mask, around) & ~ndimage.binary_erosion(mask, around)
    error = np.square(image - truth).mean(-1) / box.sum()
    return (figures["box_psnr"], figures["box_ssim"],
            *(float(error[box & part].sum()) for part in (edge, mask & ~edge, ~mask & ~edge)))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
