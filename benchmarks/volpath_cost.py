"""Cost of an image by Mitsuba's `volpath` for different representations of a field, at equal noise.

    python benchmarks/volpath_cost.py RUN --size 96 --spp 16 --repeats 6

One process, repeats interleaved: every representation renders once, then every one again with other random
    numbers. They are

    box       the `ndf` medium in its bounding box shell     the same in an `ndf_shell` nested    the same in
    nested shells with local majorants L mm      the same in nested shells, the field sampled on a grid of
    that spacing (the medium's `grid_spacing`) grid N    Mitsuba's `heterogeneous` medium in the bounding box,
    baked from the field into N³ cells

Seconds are the median over the repeats, for an image at `--spp`. Noise is the standard deviation of one
sample a pixel, from the variance between the repeats in each pixel, relative to the mean radiance. Twice the
noise takes four times the samples, so compare the last column: seconds for a standard deviation of `--noise`
in a pixel. Loading and compiling are listed separately. Error is the root mean square difference of close
images of the head, with `--reference` samples a pixel, from one of `box`, relative to the mean radiance and
with the contribution of noise removed. `noise left` is that contribution: an error below a third of it cannot
be detected. These images are rendered after all timing, and the table, printed once before, is printed again
with them. Evaluations are counted inside the media, per camera ray: null and real collisions, those of shadow
rays included. They do not depend on the machine. The performer stands in front of a constant environment.

The dense grids hold the albedo as seen from the camera, as they store no directions. Memory is the peak of
Dr.Jit's allocations while a scene is loaded and first rendered, minus what was allocated before.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from ndf_mi.experiments.trade.memory import peak_memory  # noqa: E402
from ndf_mi.run import Run  # noqa: E402

CHUNK = 64
"""Largest number of samples a pixel of one of the images that errors are computed from."""


@dataclass(frozen=True)
class Options:
    """What is measured."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of a trained run."""

    frame: int | None = None
    """Frame; by default the run's first."""

    size: int = 96
    """Height of the image in pixels; it is two thirds as wide."""

    spp: int = 16
    """Samples a pixel of a repeat."""

    repeats: int = 6
    """Timed repeats, at least 3."""

    reference: int = 1024
    """Samples a pixel of the images that errors are computed from, at least 4; 0 leaves out the errors."""

    noise: float = 0.01
    """Standard deviation of a pixel, relative to the mean radiance, that times are scaled to."""

    layers: int = 4
    """Largest number of nested shells."""

    cell: float = 0.0125
    """Spacing in metres of the grid that shells are cut from."""

    spacings: tuple[float, ...] = (0.006, 0.003)
    """Spacings in metres of the grids that the field is sampled on."""

    grids: tuple[int, ...] = (128, 256)
    """Cells of the baked grids along each side."""

    depth: int = 8
    """Longest paths."""

    ways: tuple[str, ...] = ()
    """Only these, by name; by default all."""


@dataclass
class Way:
    """A representation of the field, and its measurements."""

    name: str
    scene: mi.Scene
    load: float
    first: float
    memory: float
    seconds: list[float] = field(default_factory=list)
    pictures: list[np.ndarray] = field(default_factory=list)
    evaluations: float = 0.0


def main(options: Options) -> None:
    """Measures and prints."""
    run = Run.load(options.run)
    frame = int(run.poses.frames[0]) if options.frame is None else options.frame
    makers: dict[str, Callable[[], dict[str, Any]]] = {
        "box": lambda: box(run, {"type": "ndf", "run": str(run.path), "frame": frame}, frame),
        "shell": lambda: shell(run, frame, {"cell": options.cell}),
        "nested": lambda: shell(run, frame, {"cell": options.cell, "layers": options.layers}),
        **{f"{1e3 * size:g} mm": lambda size=size: shell(run, frame,
                                                         {"cell": options.cell, "layers": options.layers},
                                                         grid_spacing=size)
           for size in options.spacings},
        **{f"grid {n}": lambda n=n: box(run, baked(run, frame, n), frame) for n in options.grids},
    }
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, {mi.variant()}, "
          f"{run.path.name} frame {frame}, preset {run.model.field.preset.name}, "
          f"{options.size * 2 // 3} x {options.size} pixels, {options.spp} samples, depth {options.depth}\n")
    ways = [prepare(name, make, run, frame, options) for name, make in makers.items() if not options.ways
            or name in options.ways]
    for repeat in range(options.repeats):
        for way in ways:
            start = time.perf_counter()
            way.pictures.append(render(way.scene, options.spp, 100 + repeat))
            way.seconds.append(time.perf_counter() - start)
    for way in ways:
        way.evaluations = count(way.scene, options)
        majorants = [float(s.interior_medium().majorant[0]) for s in way.scene.shapes()
                     if hasattr(s.interior_medium(), "majorant")]
        if majorants:
            print(f"{way.name}: majorants " + ", ".join(f"{m:.4g}" for m in sorted(majorants)) + " per metre")
    print()
    report(ways, {}, options)
    if options.reference:
        print(flush=True)
        report(ways, errors(ways, makers["box"], run, frame, options), options)


def camera(run: Run, frame: int, options: Options, close: bool = False) -> dict[str, Any]:
    """A sensor that sees the whole body from the front; or, close, its highest 30 cm."""
    vertices = run.poses.vertices[run.poses.index(frame)]
    low, high = vertices.min(0) - 0.1, vertices.max(0) + 0.1
    centre = (low + high) / 2
    distance = 1.1 * float((high - low)[1]) / (2 * np.tan(np.radians(15)))
    if close:
        top = vertices[vertices[:, 1] > vertices[:, 1].max() - 0.3]
        centre = (top.min(0) + top.max(0)) / 2
    return {
        "type": "perspective", "fov": float(np.degrees(2 * np.arctan(0.2 / distance))) if close else 30,
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at((centre + [0, 0, distance]).tolist(), centre.tolist(),
                                                   [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": options.size * 2 // 3, "height": options.size,
                 "pixel_format": "rgb",
                 "rfilter": {"type": "box"}},
        "sampler": {"type": "independent"},
    }


def scene_of(shape: dict[str, Any], run: Run, frame: int, options: Options) -> mi.Scene:
    """The performer before a constant environment."""
    return mi.load_dict({"type": "scene", "integrator": {"type": "volpath", "max_depth": options.depth},
                         "light": {"type": "constant"},
                         "sensor": camera(run, frame, options), "performer": shape})


def shell(run: Run, frame: int, how: dict[str, Any], **more: Any) -> dict[str, Any]:
    """The medium in its shell or shells."""
    return {"type": "ndf_shell", **how,
            "interior": {"type": "ndf", "run": str(run.path), "frame": frame, **more}}


def corners(run: Run, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """The band's box."""
    bbox = run.surface(frame).bbox
    return bbox.min.numpy().ravel().astype(np.float64), bbox.max.numpy().ravel().astype(np.float64)


def box(run: Run, medium: dict[str, Any], frame: int) -> dict[str, Any]:
    """A medium in the band's box."""
    low, high = corners(run, frame)
    transform = mi.ScalarTransform4f().translate(((low + high)
                                                  / 2).tolist()).scale(((high - low) / 2).tolist())
    return {"type": "cube", "to_world": transform, "bsdf": {"type": "null"}, "interior": medium}


def baked(run: Run, frame: int, cells: int) -> dict[str, Any]:
    """The field at the middles of cells³ cells of its box, as Mitsuba's own grid medium."""
    low, high = corners(run, frame)
    posed = run.posed(frame)
    eye = mi.Point3f(*(camera(run, frame, Options(run.path))["to_world"].matrix.numpy()[:3, 3].tolist()))
    sigma, albedo = np.zeros(cells**3, np.float32), np.full((cells**3, 3), 0.5, np.float32)
    step = mi.Vector3f(*((high - low) / cells).tolist())
    with dr.suspend_grad():
        for start in range(0, cells**3, chunk := 1 << 18):
            index = dr.arange(mi.UInt32, min(chunk, cells**3 - start)) + dr.opaque(mi.UInt32, start)
            at = mi.Point3f(mi.Float(index % cells), mi.Float(index // cells % cells),
                            mi.Float(index // cells**2))
            x = mi.Point3f(*low.tolist()) + (at + 0.5) * step
            located = posed.locate(x, posed.may_contain(x))
            sample = posed.evaluate(x, dr.normalize(x - eye), located, located.valid)
            sigma[start : start + len(index)] = sample.sigma.numpy()
            some = located.valid.numpy()
            albedo[start : start + len(index)][some] = sample.colour.numpy().T[some]
    transform = mi.ScalarTransform4f().translate(low.tolist()).scale((high - low).tolist())
    volumes = {name: {"type": "gridvolume", "grid": mi.VolumeGrid(values.reshape(cells, cells, cells, -1)),
                      "to_world": transform}
               for name, values in (("sigma_t", sigma), ("albedo", albedo))}
    return {"type": "heterogeneous", **volumes}


def render(scene: mi.Scene, spp: int, seed: int, sensor: mi.Sensor | int = 0) -> np.ndarray:
    """One picture, (h, w, 3)."""
    return mi.render(scene, spp=spp, seed=seed, sensor=sensor).numpy()


def prepare(name: str, make: Callable[[], dict[str, Any]], run: Run, frame: int, options: Options) -> Way:
    """Loads a way's scene and renders it once, which compiles its kernels."""
    def work() -> tuple[mi.Scene, float, float]:
        start = time.perf_counter()
        scene = scene_of(make(), run, frame, options)
        load, start = time.perf_counter() - start, time.perf_counter()
        render(scene, options.spp, 1)
        return scene, load, time.perf_counter() - start

    (scene, load, first), memory = peak_memory(work)
    return Way(name, scene, load, first, memory / 2**20)


def count(scene: mi.Scene, options: Options) -> float:
    """Evaluations of the density a camera ray."""
    media = {id(m): m for s in scene.shapes() if (m := s.interior_medium()) is not None}.values()
    counter = dr.zeros(mi.UInt32, 1)
    dr.make_opaque(counter)
    if not all(hasattr(medium, "majorant") for medium in media):
        (shape,) = scene.shapes()
        return count_grid(shape, scene, options)
    kinds = {type(medium) for medium in media}
    originals = {kind: kind.get_scattering_coefficients for kind in kinds}
    try:
        for kind, original in originals.items():
            kind.get_scattering_coefficients = counting(original, counter)
        render(scene, 4, 3)
    finally:
        for kind, original in originals.items():
            kind.get_scattering_coefficients = original
    return int(counter[0]) / (4 * options.size * (options.size * 2 // 3))


def counting(original: Callable[..., Any], counter: mi.UInt32) -> Callable[..., Any]:
    """A medium's method that also counts its active lanes."""
    def method(self: Any, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> Any:
        dr.scatter_reduce(dr.ReduceOp.Add, counter, mi.UInt32(1), mi.UInt32(0), mi.Bool(active))
        return original(self, mei, active)
    return method


def count_grid(shape: mi.Shape, scene: mi.Scene, options: Options) -> float:
    """The same for a grid medium, whose methods can't be reached: a medium in Python with the same grids and
    majorant takes its place."""
    params = mi.traverse(shape.interior_medium())
    low, high = shape.bbox().min, shape.bbox().max
    transform = mi.ScalarTransform4f().translate(low).scale(high - low)
    volumes = [mi.load_dict({"type": "gridvolume", "grid": mi.VolumeGrid(params[f"{name}.data"].numpy()),
                             "to_world": transform})
               for name in ("sigma_t", "albedo")]
    counter = dr.zeros(mi.UInt32, 1)
    dr.make_opaque(counter)

    class Counted(mi.Medium):
        def __init__(self) -> None:
            super().__init__(mi.Properties("counted"))
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False
            self.majorant = dr.opaque(mi.Float, float(params["sigma_t.data"].numpy().max()))

        def intersect_aabb(self, ray: mi.Ray3f) -> Any:
            return mi.BoundingBox3f(mi.Point3f(low), mi.Point3f(high)).ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> Any:
            return mi.UnpolarizedSpectrum(self.majorant)

        def get_scattering_coefficients(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> Any:
            dr.scatter_reduce(dr.ReduceOp.Add, counter, mi.UInt32(1), mi.UInt32(0), mi.Bool(active))
            sigma = volumes[0].eval_1(mei, active)
            null = mi.UnpolarizedSpectrum(self.majorant - sigma)
            return sigma * volumes[1].eval(mei, active), null, mi.UnpolarizedSpectrum(sigma)

    sensor = scene.sensors()[0]
    place = mi.ScalarTransform4f().translate((low + high) / 2)
    other = mi.load_dict({"type": "scene", "integrator": {"type": "volpath", "max_depth": options.depth},
                          "light": {"type": "constant"},
                          "cube": {"type": "cube", "to_world": place.scale((high - low) / 2),
                                   "bsdf": {"type": "null"}, "interior": Counted()}, "sensor": sensor})
    render(other, 4, 3)
    return int(counter[0]) / (4 * options.size * (options.size * 2 // 3))


def sampled(scene: mi.Scene, spp: int, first: int, sensor: mi.Sensor) -> np.ndarray:
    """Independent pictures, (n, h, w, 3), whose mean has so many samples a pixel; `first` is their first
    seed."""
    each = min(CHUNK, spp // 2)
    return np.stack([render(scene, each, first + i, sensor)
                     for i in range(-(-spp // each))]).astype(np.float64)


def errors(ways: list[Way], make: Callable[[], dict[str, Any]], run: Run, frame: int,
           options: Options) -> dict[str, tuple[float, float]]:
    """Of each way but the box the error against the box, and how much noise is left in it, both over the mean
    radiance."""
    if not options.reference:
        return {}
    sensor = mi.load_dict(camera(run, frame, options, close=True))
    truth = sampled(scene_of(make(), run, frame, options), options.reference, 10_000, sensor)
    found = {}
    for number, way in enumerate(ways):
        if way.name == "box":
            continue
        pictures = sampled(way.scene, options.reference, 20_000 + 1_000 * number, sensor)
        rest = sum(float(p.var(0, ddof=1).mean()) / len(p) for p in (pictures, truth))
        square = float(((pictures.mean(0) - truth.mean(0)) ** 2).mean()) - rest
        # Where noise alone would be larger, nothing can be concluded.
        found[way.name] = np.sqrt(max(square, 0)) / truth.mean(), np.sqrt(rest) / truth.mean()
    return found


def report(ways: list[Way], off: dict[str, tuple[float, float]], options: Options) -> None:
    """Prints the table."""
    print("| way | seconds | noise of a sample | evaluations a ray | error | noise left | loading, s "
          f"| first picture, s | memory, MiB | seconds for {100 * options.noise:g} % noise |")
    print("| --- " + "| ---: " * 9 + "|")
    for way in ways:
        pictures = np.stack(way.pictures).astype(np.float64)
        level = pictures.mean()
        variance = float(pictures.var(0, ddof=1).mean()) * options.spp / level**2
        seconds = float(np.median(way.seconds))
        error, left = (f"{100 * value:.2f} %" for value in off[way.name]) if way.name in off else ("–", "–")
        needed = seconds / options.spp * variance / options.noise**2
        print(f"| {way.name} | {seconds:.2f} | {np.sqrt(variance):.2f} | {way.evaluations:.1f} | {error} "
              f"| {left} | {way.load:.1f} | {way.first:.1f} | {way.memory:.0f} | {needed:.1f} |")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
