"""Closest points on a mesh, compared with Open3D (Embree) and libigl in one process, repeats interleaved.

    python benchmarks/closest_point.py --mesh body --repeats 7

Two sets of queries around each mesh, all within the band: points uniform in the band in random order, and
samples of camera rays in the rays' order. `closest` finds the triangle; `project` adds texture coordinates,
signed distance, normal and closest point. Times are wall-clock medians; a ratio is the median of the ratios
within each repeat. Needs `pip install ndf-mi[bench]`; Open3D's wheel also needs the system's libusb-1.0,
libGL, libX11 and libgomp.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Literal, TypeAlias

import numpy as np
import trimesh
import tyro

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402
import igl  # noqa: E402
import mitsuba as mi  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402

from ndf_mi.body.anny import load_anny  # noqa: E402
from ndf_mi.optional import require  # noqa: E402
from ndf_mi.projection import PosedSurface, Surface  # noqa: E402

Distance: TypeAlias = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Options:
    """What is measured.

    Attributes:
        count: queries a set.
        repeats: of each measurement, after one that is not counted.
        band: metres.
        igl_count: queries given to libigl, which is slower; its speed is scaled from them.
        seed: of the queries.
        mesh: which meshes: the default body, the body with each triangle split in four, a ball.
    """

    count: int = 1_000_000
    repeats: int = 7
    band: float = 0.08
    igl_count: int = 100_000
    seed: int = 0
    mesh: tuple[Literal["body", "split", "ball"], ...] = ("body", "split", "ball")


def load(name: str) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) float64 vertices in metres and (F, 3) int64 triangles."""
    if name == "ball":
        ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
        return np.asarray(ball.vertices), np.asarray(ball.faces)
    body = load_anny()
    vertices, faces = np.asarray(body.template, np.float64), np.asarray(body.faces, np.int64)
    return (vertices, faces) if name == "body" else trimesh.remesh.subdivide(vertices, faces)[:2]


def band_points(distance: Distance, box: np.ndarray, options: Options) -> np.ndarray:
    """(count, 3) float32, uniform in the band."""
    rng = np.random.default_rng(options.seed)
    kept: list[np.ndarray] = []
    while sum(map(len, kept)) < options.count:
        x = rng.uniform(box[0] - options.band, box[1] + options.band, (options.count, 3)).astype(np.float32)
        kept.append(x[distance(x) <= options.band])
    return np.concatenate(kept)[: options.count]


def ray_points(distance: Distance, box: np.ndarray, options: Options) -> np.ndarray:
    """(count, 3) float32: samples 5 mm apart along rays of cameras in a ring, ray after ray, those in the
    band."""
    rng = np.random.default_rng(options.seed)
    centre, reach = box.mean(0), float(np.linalg.norm(box[1] - box[0]))
    along = np.arange(0.6 * reach, 2.4 * reach, 0.005)
    kept: list[np.ndarray] = []
    while sum(map(len, kept)) < options.count:
        angle = rng.uniform(0, 2 * np.pi)
        eye = centre + 1.5 * reach * np.array([np.sin(angle), 0.2, np.cos(angle)])
        way = rng.uniform(box[0], box[1], (2000, 3)) - eye
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        x = (eye + way[:, None] * along[:, None]).reshape(-1, 3).astype(np.float32)
        kept.append(x[distance(x) <= options.band])
    return np.concatenate(kept)[: options.count]


def seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def machine() -> str:
    model = platform.processor()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8") as stream:
            names = [line.split(":", 1)[1].strip() for line in stream if line.startswith("model name")]
        model = names[0] if names else model
    versions = ", ".join(f"{name} {version(name)}" for name in ("mitsuba", "drjit", "open3d", "libigl"))
    load = os.getloadavg()[0]
    cores = f"{os.cpu_count()} cores, {mi.variant()}, {dr.thread_count()} threads"
    return f"{model}, {cores}; {versions}; load {load:.1f}"


def main(options: Options) -> None:
    """Measures and prints one table."""
    open3d = require("open3d", "bench")
    console = Console(width=120)
    console.print(machine())
    table = Table(title=f"Million queries a second within {options.band} m; ratio to Open3D in brackets")
    for column in (
        "mesh", "triangles", "queries", "closest", "project", "Open3D", "libigl", "largest difference",
        "pose",
    ):
        table.add_column(column, justify="left" if column in ("mesh", "queries") else "right")
    for name in options.mesh:
        vertices, faces = load(name)
        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))

        def distance(x: np.ndarray, scene: Any = scene) -> np.ndarray:
            return scene.compute_distance(open3d.core.Tensor(x)).numpy()

        tree = igl.AABB()
        tree.init(vertices, faces)
        surface = Surface(faces, np.zeros((1, 2)), np.zeros_like(faces), vertices)
        flat = mi.Float(vertices.astype(np.float32).ravel())
        posed = PosedSurface(surface, flat, options.band)
        box = np.stack([vertices.min(0), vertices.max(0)])
        for kind, make in (("band", band_points), ("rays", ray_points)):
            x = make(distance, box, options)
            query, tensor = mi.Point3f(np.ascontiguousarray(x.T)), open3d.core.Tensor(x)
            few = x[: options.igl_count]
            few64 = few.astype(np.float64)
            dr.eval(query)
            works: dict[str, Callable[[], object]] = {
                "closest": lambda posed=posed, query=query: (dr.eval(posed.closest(query)), dr.sync_thread()),
                "project": lambda posed=posed, query=query: (dr.eval(posed.project(query)), dr.sync_thread()),
                "Open3D": lambda scene=scene, tensor=tensor: scene.compute_closest_points(tensor),
                "libigl": lambda tree=tree, v=vertices, f=faces, p=few64: tree.squared_distance(v, f, p),
                "pose": lambda surface=surface, flat=flat: (
                    PosedSurface(surface, flat, options.band), dr.sync_thread()
                ),
            }
            times: dict[str, list[float]] = {key: [] for key in works}
            for _ in range(options.repeats + 1):
                for key, work in works.items():
                    times[key].append(seconds(work) * (len(x) / len(few) if key == "libigl" else 1))
            spent = {key: np.array(values[1:]) for key, values in times.items()}
            truth = np.linalg.norm(scene.compute_closest_points(tensor)["points"].numpy() - x, axis=1)
            difference = np.abs(np.abs(np.asarray(posed.project(query).l)) - truth).max()

            def speed(key: str, spent: dict[str, np.ndarray] = spent, count: int = len(x)) -> str:
                ratio = np.median(spent["Open3D"] / spent[key])
                return f"{count / 1e6 / np.median(spent[key]):.2f}" + (
                    f" ({ratio:.1f})" if key != "Open3D" else ""
                )

            rates = [speed(key) for key in ("closest", "project", "Open3D", "libigl")]
            pose = f"{1000 * np.median(spent['pose']):.0f} ms"
            table.add_row(name, f"{len(faces):,}", kind, *rates, f"{difference:.1e} m", pose)
    console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
