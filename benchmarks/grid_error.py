"""How far a field on a sparse grid, and one baked into Mitsuba's grid medium, are from the field itself,
without noise.

    python benchmarks/grid_error.py RUN --size 96

Renders a close view of the head by quadrature, `--samples` a ray, from the field, from sparse grids (the
medium's `grid_spacing`) and from dense grids over the band's box as `volpath_cost.py` bakes them. Prints root
mean square differences of opacity and of premultiplied linear colour over the pixels where the field's
opacity is above a hundredth, and the number of cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402
import volpath_cost  # noqa: E402

from ndf_mi.field.sample import FieldSample, Located  # noqa: E402
from ndf_mi.render.quadrature import quadrature  # noqa: E402
from ndf_mi.render.ray_samples import VolumeField  # noqa: E402
from ndf_mi.render.sparse_grid import SparseGrid  # noqa: E402
from ndf_mi.run import Run  # noqa: E402


@dataclass(frozen=True)
class Options:
    """What is compared."""

    run: Annotated[Path, tyro.conf.Positional]
    """Folder of a trained run."""

    size: int = 96
    """Height of the picture in pixels; it is two thirds as wide."""

    samples: int = 1024
    """Samples a ray."""

    spacings: tuple[float, ...] = (0.012, 0.006, 0.003)
    """Spacings in metres."""

    grids: tuple[int, ...] = (128, 256)
    """Cells of the baked grids along each side."""


class Grid:
    """Mitsuba's grid volumes as a field."""

    sample_factor = 1

    def __init__(self, medium: dict[str, Any], bbox: mi.BoundingBox3f) -> None:
        self.bbox = bbox
        self._sigma, self._albedo = (mi.load_dict(medium[name]) for name in ("sigma_t", "albedo"))

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """True."""
        return dr.full(mi.Bool, True, dr.width(x))

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """Every active point is valid."""
        return Located.anywhere(active)

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """The volumes at points."""
        it = dr.zeros(mi.Interaction3f, dr.width(x))
        it.p = x
        return FieldSample(
            self._sigma.eval_1(it, active), mi.Color3f(self._albedo.eval(it, active)), dr.zeros(mi.Point3f),
            dr.zeros(mi.Normal3f),
        )


def main(options: Options) -> None:
    """Measures and prints."""
    run = Run.load(options.run)
    frame = int(run.poses.frames[0])
    posed, preset = run.posed(frame), run.model.field.preset
    vertices = mi.Float(run.poses.vertices[0].ravel())
    view = volpath_cost.camera(run, frame, volpath_cost.Options(options.run, size=options.size), close=True)
    sensor = mi.load_dict(view)
    width, height = view["film"]["width"], view["film"]["height"]
    y, x = (v.ravel() + 0.5 for v in np.mgrid[:height, :width])
    ray, _ = sensor.sample_ray(
        0.0, 0.5, mi.Point2f(mi.Float(x / width), mi.Float(y / height)), mi.Point2f(0.5)
    )
    rays = mi.Ray3f(ray.o + dr.zeros(mi.Point3f, width * height), ray.d)
    print(
        f"{mi.variant()}, {run.path.name} frame {frame}, preset {preset.name}, "
        f"{width} x {height} pixels, {options.samples} samples\n"
    )
    low, high = volpath_cost.corners(run, frame)
    for n in options.grids:
        print(f"cells of grid {n}: " + " x ".join(f"{1e3 * side:.1f}" for side in (high - low) / n) + " mm")
    truth = seen(posed, rays, options)
    where = truth[3] > 0.01
    print("\n| way | opacity | colour |\n| --- | ---: | ---: |")
    for size in options.spacings:
        held = SparseGrid(posed, run.model.surface, vertices, max(preset.band, preset.band_inside), size)
        row(f"sparse grid of {1e3 * size:g} mm", seen(held, rays, options), truth, where)
    for n in options.grids:
        row(
            f"grid {n}", seen(Grid(volpath_cost.baked(run, frame, n), posed.bbox), rays, options), truth,
            where,
        )


def seen(volume: VolumeField, rays: mi.Ray3f, options: Options) -> np.ndarray:
    """(4, N) linear colour and opacity."""
    parts = []
    with dr.suspend_grad():
        for start in range(0, dr.width(rays.d), step := 512):
            index = dr.minimum(dr.arange(mi.UInt32, step) + dr.opaque(mi.UInt32, start), dr.width(rays.d) - 1)
            some = mi.Ray3f(dr.gather(mi.Point3f, rays.o, index), dr.gather(mi.Vector3f, rays.d, index))
            found = quadrature(volume, some, options.samples)
            rows = [*found.colour, found.opacity]
            dr.eval(rows)
            parts.append(np.stack([value.numpy() for value in rows]))
    return np.concatenate(parts, 1)[:, : dr.width(rays.d)].astype(np.float64)


def row(name: str, found: np.ndarray, truth: np.ndarray, where: np.ndarray) -> None:
    """Prints a way's differences."""
    off = np.square(found - truth)[:, where]
    print(f"| {name} | {np.sqrt(off[3].mean()):.4f} | {np.sqrt(off[:3].mean()):.4f} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
