"""What a band of its own width at each place saves, against one width for all.

    python benchmarks/bands.py CAPTURE --steps 300

Derives the widths from where masks and body disagree, and trains two new fields in turns, step by step: one
with these widths, one with their largest everywhere. Prints the widths, the time of steps and of images, how
many samples reach the networks, and the PSNR of both over the whole of novel views.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from ndf_mi.capture.camera import Camera  # noqa: E402
from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.field import preset  # noqa: E402
from ndf_mi.learn.options import TrainingOptions  # noqa: E402
from ndf_mi.learn.trainer import Trainer  # noqa: E402
from ndf_mi.model import PosedModel  # noqa: E402
from ndf_mi.planning.bands import place_bands  # noqa: E402
from ndf_mi.planning.detail import detail  # noqa: E402
from ndf_mi.planning.observations import chosen_frames, observe  # noqa: E402
from ndf_mi.planning.plan import PlanSettings  # noqa: E402
from ndf_mi.planning.standoff import standoff  # noqa: E402
from ndf_mi.render.image import ImageRenderer  # noqa: E402
from ndf_mi.render.sampling import box_interval, stratified  # noqa: E402
from ndf_mi.run import Run  # noqa: E402


@dataclass(frozen=True)
class Options:
    """What is measured."""

    capture: Annotated[Path, tyro.conf.Positional]
    """A capture's folder."""

    steps: int = 300
    """Steps of each field; the second half is timed."""

    images: int = 3
    """Novel views that are rendered."""


def main(options: Options) -> None:
    """Measures and prints."""
    capture = Capture.read(options.capture)
    began = time.perf_counter()
    widths = derived(capture)
    outside, inside = widths.T
    print(f"{os.cpu_count()} cores, {mi.variant()}, capture {capture.name}: widths derived in "
          f"{time.perf_counter() - began:.1f} s")
    for name, width in (("outside", outside), ("inside", inside)):
        low, median, high = 1e3 * np.quantile(width, [0.05, 0.5, 0.95])
        print(f"  {name}: {low:.0f}, {median:.0f}, {high:.0f} mm (5 %, median, 95 % of vertices), largest "
              f"{1e3 * width.max():.0f} mm")
    widest = dataclasses.replace(preset("fast"), band=float(outside.max()), band_inside=float(inside.max()))
    training = TrainingOptions(steps=options.steps)
    with tempfile.TemporaryDirectory() as folder:
        trainers = {}
        for name, bands in (("one width", {}), ("of each place", {"bands": widths})):
            run = Run.create(Path(folder) / name, widest, capture.body, capture.poses, 1, bands,
                             background=[float(v) for v in capture.background])
            trainers[name] = Trainer(run, capture, training)
        steps, evaluated = ({name: [] for name in trainers} for _ in range(2))
        for _ in range(options.steps):
            for name, trainer in trainers.items():
                begun = time.perf_counter()
                trainer.step()
                dr.sync_thread()
                steps[name].append(time.perf_counter() - begun)
                evaluated[name].append(trainer.progress.evaluated)
        half = options.steps // 2
        for trainer in trainers.values():
            trainer.publish()
        pictures = {name: [] for name in trainers}
        split = capture.splits["novel_view"]
        views = [(camera, frame) for frame in split.frames for camera in split.cameras][:: max(
            len(split.frames) * len(split.cameras) // options.images, 1)][: options.images]
        for camera, frame in views:
            for name, trainer in trainers.items():
                volume = trainer.run.posed(frame)
                ImageRenderer()(volume, capture.cameras[camera])
                begun = time.perf_counter()
                image = ImageRenderer()(volume, capture.cameras[camera])
                seconds = time.perf_counter() - begun
                error = np.mean((image.over(capture.background) - capture.image(camera, frame)) ** 2)
                pictures[name].append((seconds, searched(volume, capture.cameras[camera]),
                                       image.work.evaluated / image.opacity.size, error))
        print("samples: in the networks, a step; searched, evaluated: a pixel; PSNR: whole images")
        print(f"{'':15} {'step':>9} {'samples':>9} {'image':>9} {'searched':>9} {'evaluated':>9} {'PSNR':>9}")
        for name in trainers:
            seconds, looked_up, used, error = np.array(pictures[name]).T
            print(f"{name:15} {1e3 * np.median(steps[name][half:]):6.0f} ms "
                  f"{np.mean(evaluated[name][half:]):9.0f} {1e3 * np.median(seconds):6.0f} ms "
                  f"{looked_up.mean():9.1f} {used.mean():9.1f} "
                  f"{-10 * np.log10(error.mean()):6.2f} dB")


def searched(volume: PosedModel, camera: Camera, samples: int = 128) -> float:
    """How many of the samples of a pixel's ray pass the test by cells, on average over the image."""
    index = dr.arange(mi.UInt32, camera.w * camera.h)
    ray = camera.rays(mi.Point2f(mi.Float(index % camera.w), mi.Float(index // camera.w)) + 0.5)
    hit, near, far = box_interval(volume.bbox, ray)
    t, _ = stratified(near, far, samples, None)
    pixel = dr.arange(mi.UInt32, samples * camera.w * camera.h) // samples
    x = dr.gather(mi.Point3f, ray.o, pixel) + dr.gather(mi.Vector3f, ray.d, pixel) * t
    found = dr.gather(mi.Bool, hit, pixel) & volume.may_contain(x)
    return float(dr.count(found)[0]) / (camera.w * camera.h)


def derived(capture: Capture) -> np.ndarray:
    """The widths of the band at each vertex of the capture's own body."""
    settings = PlanSettings()
    body = capture.body
    frames = chosen_frames(capture, settings.frames)
    observations, views = observe(capture, frames)
    rest = capture.poses.vertices[0] if body.template is None else body.template
    half = detail(body, rest.astype(np.float64), observations, views).footprint / 2
    return place_bands(rest, body.faces, standoff(capture, frames, views), settings.allowed_error, half,
                       preset("fast"))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
