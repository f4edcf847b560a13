"""Cost of an image: whole rays or front to back in rounds, networks as matrix products or as cooperative
vectors.

    python benchmarks/image.py RUN --capture CAPTURE --images 8 --repeats 3

Renders novel views of the capture in every way, interleaved, so that other load on the machine affects all
alike. Prints the median seconds an image, and the root mean square and the 99.9th percentile of the
difference from the first way in linear colour.
"""

from __future__ import annotations

import os
import platform
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated
from unittest import mock

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

import mitsuba as mi  # noqa: E402

from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.render.image import ImageRenderer  # noqa: E402
from ndf_mi.run import Run  # noqa: E402


@dataclass(frozen=True)
class Options:
    """What is measured."""

    run: Annotated[Path, tyro.conf.Positional]
    """A trained run."""

    capture: Path
    """Its capture."""

    images: int = 8
    """Images."""

    repeats: int = 3
    """How often every image is rendered in every way, after a first time, which compiles and is not timed."""

    samples: int = 128
    """Candidate samples a ray."""


def main(options: Options) -> None:
    """Measures and prints."""
    run, capture = Run.load(options.run), Capture.read(options.capture)
    views = list(capture.splits["novel_view"])[
        :: max(len(capture.splits["novel_view"]) // options.images, 1)
    ][: options.images]
    width = variants.fused_width()
    ways = {
        "whole rays, matrix products": (ImageRenderer(options.samples, rounds=1, cutoff=0.0), 0),
        "whole rays, cooperative vectors": (ImageRenderer(options.samples, rounds=1, cutoff=0.0), width),
        "rounds, matrix products": (ImageRenderer(options.samples), 0),
        "rounds, cooperative vectors (what is used)": (ImageRenderer(options.samples), width),
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    differences: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    for repeat in range(options.repeats + 1):
        for camera, frame in views:
            first = None
            for name, (renderer, fused) in ways.items():
                with mock.patch.object(variants, "fused_width", lambda fused=fused: fused):
                    begun = time.perf_counter()
                    image = renderer(run.posed(frame), capture.cameras[camera]).linear
                    taken = time.perf_counter() - begun
                first = image if first is None else first
                if repeat:
                    seconds[name].append(taken)
                else:
                    differences[name].append(np.abs(image - first).max(-1).ravel())
    print(
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, {mi.variant()}, "
        f"{len(views)} images of {capture.cameras[views[0][0]].w} x {capture.cameras[views[0][0]].h}, "
        f"{options.samples} samples a ray\n"
    )
    print("| | seconds an image | rms difference | 99.9 % below |\n| --- | --- | --- | --- |")
    for name in ways:
        d = np.concatenate(differences[name])
        print(f"| {name} | {np.median(seconds[name]):.2f} | {np.sqrt(np.mean(d**2)):.1e} | "
              f"{np.percentile(d, 99.9):.1e} |")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
