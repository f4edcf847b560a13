"""How time and memory of a picture grow with rays, samples, triangles, frames and the networks' width.

    python benchmarks/growth.py RUN -o growth --repeats 5

Each curve raises one quantity over a decade or more and keeps the rest: `--size` pixels, 64 samples,
quadrature, the run's preset and frame.

    rays        pictures of the run from 32 × 32 pixels on, by the number of rays that hit the body's box
    samples     candidate samples a ray
    triangles   a sphere of finer and finer triangles in place of the body, with the run's preset, untrained
    posing      the same sphere, only posed: boxes, cells and search tree
    frames      successive frames of the run, each posed for the first time; up to 128 poses are kept
    width       hidden layers of the networks, as cooperative vectors and as matrix products; untrained, each
                ray to its end

After a round that compiles the kernels, every repeat measures each point of all curves once, in random order.
Seconds are medians. Memory is the peak of Dr.Jit's allocations minus what was allocated before. The benchmark
writes growth.csv and growth.html with plots and fits of y = fixed + factor·x^exponent, and prints a sentence
for each curve. A curve of fewer than three points, such as the frames of a run that has two, appears in the
table only.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
import tyro
from growth_fit import fit_growth

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from ndf_mi import files, machine  # noqa: E402
from ndf_mi.body.body import Body  # noqa: E402
from ndf_mi.body.poses import Poses  # noqa: E402
from ndf_mi.capture.camera import Camera, framing  # noqa: E402
from ndf_mi.experiments.trade.memory import MEANING, peak_memory  # noqa: E402
from ndf_mi.model import networks_here  # noqa: E402
from ndf_mi.render.settings import Setting  # noqa: E402
from ndf_mi.reports.charts import fit_chart  # noqa: E402
from ndf_mi.reports.page import Fact, write_page  # noqa: E402
from ndf_mi.run import Run  # noqa: E402

CURVES = ("rays", "samples", "triangles", "posing", "frames", "width")
# The quantity that is raised, where the curve has another name.
RAISED = {"posing": "triangles", "width, fused": "width", "width, batched": "width"}


@dataclass(frozen=True)
class Options:
    """Options of the benchmark."""

    run: Annotated[Path, tyro.conf.Positional]
    """A trained run."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the table and the plots."""

    curves: tuple[str, ...] = CURVES
    """The curves to measure."""

    size: int = 128
    """Width and height in pixels, except for the curve `rays`."""

    repeats: int = 5
    """How often every point is timed."""


@dataclass
class Point:
    """One point of a curve: the value of the raised quantity, and the work that is timed."""

    curve: str
    x: float
    draw: Callable[[], None]
    seconds: list[float] = field(default_factory=list)
    memory: int = 0


def main(options: Options) -> None:
    """Measures, writes and prints."""
    run = Run.load(options.run)
    camera = framing(run.poses.vertices[0], options.size, options.size)
    made = {
        "rays": lambda: rays(run),
        "samples": lambda: samples(run, camera),
        "frames": lambda: frames(run, options.size),
        "triangles": lambda: triangles(run, options.size, posing=False),
        "posing": lambda: triangles(run, options.size, posing=True),
        "width": lambda: width(run, camera),
    }
    points = [point for curve in options.curves for point in made[curve]()]
    for number, point in enumerate(points, start=1):
        print(f"\rcompiling and counting: {number} of {len(points)}", end="", flush=True)
        _, point.memory = peak_memory(point.draw)
    for repeat in range(options.repeats):
        for index in np.random.default_rng(repeat).permutation(len(points)):
            begun = time.perf_counter()
            points[index].draw()
            dr.sync_thread()
            points[index].seconds.append(time.perf_counter() - begun)
        print(f"\rtimed: {repeat + 1} of {options.repeats}" + 30 * " ", end="", flush=True)
    print("\n")
    write(points, options)


def rays(run: Run) -> list[Point]:
    """Pictures of increasing size."""
    found = []
    for size in (32, 48, 64, 96, 128, 192, 256, 384, 512):
        camera = framing(run.poses.vertices[0], size, size)
        met = Setting(64).renderer().met(run.posed(int(run.poses.frames[0])), camera)
        found.append(Point("rays", met, lambda camera=camera: draw(run, camera, Setting(64))))
    return found


def samples(run: Run, camera: Camera) -> list[Point]:
    """Pictures with more and more samples a ray."""
    numbers = (8, 16, 32, 64, 128, 256, 512, 1024)
    return [Point("samples", n, lambda n=n: draw(run, camera, Setting(n))) for n in numbers]


def triangles(run: Run, size: int, posing: bool) -> list[Point]:
    """Spheres as large as a person is wide, with finer and finer triangles."""
    found = []
    for subdivisions in range(2, 8):
        ball = sphere(run, subdivisions)
        vertices = ball.poses.vertices[0]
        camera = framing(vertices, size, size)
        flat = mi.Float(vertices.ravel())
        one = (lambda ball=ball, flat=flat: pose(ball, flat)) if posing else (
            lambda ball=ball, camera=camera: draw(ball, camera, Setting(64, cutoff=0.0)))
        found.append(Point("posing" if posing else "triangles", len(ball.body.faces), one))
    return found


def frames(run: Run, size: int) -> list[Point]:
    """Successive frames of a run that has not posed any of them."""
    numbers = [int(frame) for frame in run.poses.frames]
    counts = (n for n in (1, 2, 4, 8, 16, 32) if n <= len(numbers))
    return [Point("frames", n, lambda n=n: sequence(run, numbers[:n], size)) for n in counts]


def width(run: Run, camera: Camera) -> list[Point]:
    """Wider and wider networks in both forms."""
    found = []
    for layers in (8, 16, 32, 64, 128, 256):
        networks = {"density_layers": (layers,), "colour_layers": (layers,)}
        preset = dataclasses.replace(run.model.field.preset, **networks)
        other = Run.create(run.path, preset, run.body, run.poses, 0, background=[0.0, 0.0, 0.0])
        for form in (form for form in ("fused", "batched") if form in networks_here()):
            setting = Setting(64, cutoff=0.0, networks=form)
            drawn = partial(draw, other, camera, setting)
            found.append(Point(f"width, {form}", layers, drawn))
    return found


def draw(run: Run, camera: Camera, setting: Setting) -> None:
    """A picture of the run's first frame, in memory."""
    setting.image(run, int(run.poses.frames[0]), camera)


def pose(run: Run, vertices: mi.Float) -> None:
    """Poses the body and makes everything that searches need."""
    surface = run.model.pose(vertices)
    dr.eval(surface.bbox.min, surface.closest(mi.Point3f(0.0, 0.0, 0.0), mi.Bool(True)))


def sequence(run: Run, numbers: list[int], size: int) -> None:
    """Pictures of frames, from a run that shares the field but keeps no poses yet."""
    fresh = Run(run.path, run.config, run.body, run.poses, run.model, run.parameters)
    for number in numbers:
        camera = framing(run.poses.vertices[run.poses.index(number)], size, size)
        Setting(64).renderer()(fresh.posed(number), camera)


def sphere(run: Run, subdivisions: int) -> Run:
    """A ball of radius 0.3 m and 20·4^n triangles, with the run's preset."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.3)
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    corners = vertices[faces.ravel()] / 0.3
    u = (0.5 + np.arctan2(corners[:, 0], corners[:, 2]) / (2 * np.pi)).reshape(-1, 3)
    # Triangles that cross the meridian where u jumps continue beyond 1.
    u[(u.max(1) - u.min(1) > 0.5)[:, None] & (u < 0.5)] += 1
    uv = np.stack([u.ravel() / 1.5, 0.5 + np.arcsin(np.clip(corners[:, 1], -1, 1)) / np.pi], -1)
    uv_faces = np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    body = Body(faces=faces, uv=np.clip(uv, 0, 1).astype(np.float32), uv_faces=uv_faces, template=vertices)
    nothing = np.zeros((1, 3), np.float32)
    poses = Poses(frames=np.zeros(1, np.int32), vertices=vertices[None], pose=nothing[None],
                  root_rotation=nothing, translation=nothing)
    return Run.create(run.path, run.model.field.preset, body, poses, 0, background=[0.0, 0.0, 0.0])


def write(points: list[Point], options: Options) -> None:
    """Writes table and page, and prints the sentences."""
    stream = io.StringIO()
    sheet = csv.writer(stream, lineterminator="\n")
    sheet.writerow(["curve", "x", "seconds", "seconds_least", "seconds_most", "peak_bytes"])
    for point in points:
        seconds = np.median(point.seconds), min(point.seconds), max(point.seconds)
        sheet.writerow([point.curve, point.x, *seconds, point.memory])
    files.write_text(options.out / "growth.csv", stream.getvalue())
    curves = []
    for curve in dict.fromkeys(point.curve for point in points):
        mine = [point for point in points if point.curve == curve]
        x = [point.x for point in mine]
        charts, sentences = [], []
        costs = [("Time", "s", [float(np.median(point.seconds)) for point in mine]),
                 ("Memory", "MiB", [max(point.memory, 1) / 2**20 for point in mine])]
        if len(mine) < 3:
            number = f"{len(mine)} point{'' if len(mine) == 1 else 's'}"
            sentences.append(f"{number}: too few to fit a curve, which takes three.")
            costs = []
        for cost, unit, values in costs:
            growth = fit_growth(x, values)
            line = np.geomspace(x[0], x[-1], 100)
            fit = (growth.formula(), line, growth.at(line))
            charts.append(fit_chart(("measured", x, values), fit, RAISED.get(curve, curve), unit, cost))
            sentences.append(growth.sentence(cost, RAISED.get(curve, curve), unit))
        print(f"{curve}\n  " + "\n  ".join(sentences))
        curves.append({"name": curve, "charts": charts, "sentences": sentences})
    origin = [Fact(label, (value,)) for label, value in machine.describe().items()]
    write_page(options.out / "growth.html", "growth.html.j2", curves=curves, repeats=options.repeats,
               memory=MEANING, origin=origin)
    print(f"\n{options.out / 'growth.html'}")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
