"""Time and noise of the scenes around a performer under `ndf_path`.

    python benchmarks/ndf_path.py RUN --size 256 --spp 16 --repeats 3

Prints for each scene the median seconds of a warm rendering, the seconds of the first one (which compiles),
and those of the same scene without the performer's shapes under Mitsuba's `path`; the samples that reached
the networks and the kernels compiled while timing; and the
noise: the root mean square error of an image relative to its mean, estimated from the differences of
independent images. Noise falls with the square root of the samples a pixel.
"""

from __future__ import annotations

import os
import platform
import re
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

SCENES = Path(__file__).parents[1] / "scenes"


@dataclass(frozen=True)
class Options:
    """What is measured."""

    run: Annotated[Path, tyro.conf.Positional]
    """A run's folder."""

    scenes: tuple[str, ...] = ("performer", "turntable", "studio", "two", "environment")
    """Names of scenes. `performer` is a performer alone, for comparison with `ndf_quadrature`, which is
    measured, too."""

    size: int = 256
    """Pixels on a side."""

    spp: int = 16
    """Samples a pixel."""

    repeats: int = 3
    """Images timed, at least 2."""


def main(options: Options) -> None:
    """Measures and prints."""
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, {mi.variant()}, run "
          f"{options.run}, {options.size} × {options.size} pixels, {options.spp} samples a pixel")
    print(f"{'scene':<28}{'seconds':>9}{'first':>9}{'samples':>13}{'compiled':>10}{'noise':>9}")
    for name in options.scenes:
        parameters = {"width": options.size, "height": options.size, "spp": options.spp}
        path = str(SCENES / f"{name}.xml")
        measure(name, mi.load_file(path, integrator="ndf_path", run=str(options.run), **parameters), options)
        if name == "performer":
            scene = mi.load_file(path, integrator="ndf_quadrature", run=str(options.run), **parameters)
            measure(f"{name}, ndf_quadrature", scene, options)
        measure(
            f"{name} without, path", mi.load_string(empty(path), integrator="path", **parameters), options
        )


def empty(path: str) -> str:
    """A scene's XML without its performers."""
    return re.sub(
        r'<shape type="ndf_shell".*?</shape>', "", Path(path).read_text(encoding="utf-8"), flags=re.DOTALL
    )


def measure(name: str, scene: mi.Scene, options: Options) -> None:
    """Times one scene and prints a line."""
    transport = getattr(scene.integrator(), "transport", None)
    seconds: list[float] = []
    pictures, compiled, evaluated = [], 0, 0
    for seed in range(options.repeats + 1):
        before = transport.evaluated if transport else 0
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            begun = time.perf_counter()
            picture = mi.render(scene, seed=seed, spp=options.spp)
            dr.eval(picture)
            dr.sync_thread()
            seconds.append(time.perf_counter() - begun)
            fresh = sum(not kernel["cache_hit"] for kernel in dr.kernel_history([dr.KernelType.JIT]))
        if seed:
            compiled += fresh
            pictures.append(picture.numpy()[..., :3].astype(np.float64))
            evaluated = transport.evaluated - before if transport else 0
    stack = np.stack(pictures)
    noise = np.sqrt(stack.var(axis=0, ddof=1).mean()) / stack.mean()
    print(
        f"{name:<28}{np.median(seconds[1:]):>9.2f}{seconds[0]:>9.2f}"
        f"{evaluated:>13,}{compiled:>10}{noise:>9.4f}"
    )


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
