"""Writes the files of this folder. Runs with ndf-mi 0.1.0 (commit 3b916d9) only: see README.md."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np

from ndf_mi import files, variants

variants.use()

import mitsuba as mi  # noqa: E402
from sphere_capture import BACKGROUND, FRAMES, draw, ring_camera, sphere  # noqa: E402

from ndf_mi.body.poses import Poses  # noqa: E402
from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.capture.document import Document, Split  # noqa: E402
from ndf_mi.capture.writer import CaptureWriter  # noqa: E402
from ndf_mi.compare import comparison, machine, relighting  # noqa: E402
from ndf_mi.compare.ablation import Settings as AblationSettings  # noqa: E402
from ndf_mi.compare.ablation import Study  # noqa: E402
from ndf_mi.compare.methods import mesh_fit, offset_fit  # noqa: E402
from ndf_mi.compare.trade import points, study  # noqa: E402
from ndf_mi.field import preset  # noqa: E402
from ndf_mi.learn import loop  # noqa: E402
from ndf_mi.learn.options import TrainingOptions  # noqa: E402
from ndf_mi.learn.scattering import relightable  # noqa: E402
from ndf_mi.planning.plan import Settings as PlanSettings  # noqa: E402
from ndf_mi.planning.planner import plan  # noqa: E402
from ndf_mi.render.image import ImageRenderer  # noqa: E402
from ndf_mi.run import Run  # noqa: E402

SIZE = 24
LIGHTS = {
    "day": '<emitter type="constant"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>'
    '<emitter type="directional"><vector name="direction" value="-0.5, -0.7, -0.6"/>'
    '<rgb name="irradiance" value="3, 2.7, 2.2"/></emitter>',
    "night": '<emitter type="constant"><rgb name="radiance" value="0.1, 0.15, 0.25"/></emitter>'
    '<emitter type="directional"><vector name="direction" value="0.9, -0.2, 0.4"/>'
    '<rgb name="irradiance" value="4, 2, 0.8"/></emitter>',
}
OPTIONS = TrainingOptions(steps=40, rays=256, samples=24)
TINY = dataclasses.replace(preset("tiny"), grid_levels=2, grid_entries=2**8, direction_octaves=-1, strata=2)


def write_capture(path: Path, lighting: str | None = None) -> Capture:
    """The tests' textured sphere, smaller and with fewer cameras."""
    body = sphere(12, 16)
    shifts = np.array([[0, 0, 0], [0.1, 0, 0.05], [-0.1, 0.1, 0]], dtype=np.float32)
    vertices = body.template[None] + shifts[:, None]
    zeros = np.zeros((3, 3), dtype=np.float32)
    poses = Poses(np.array(FRAMES), vertices, np.zeros((3, 1, 3), np.float32), zeros, shifts)
    cameras = [ring_camera(f"c{i}", 1.57 * i, 0.5 * (-1) ** i, SIZE) for i in range(4)] + [
        ring_camera("n0", 0.8, size=SIZE)
    ]
    splits = {
        "train": Split(("c0", "c1", "c2", "c3"), FRAMES[:2]),
        "novel_view": Split(("n0",), FRAMES[:2]),
        "novel_pose": Split(("n0",), FRAMES[2:]),
    }
    document = Document(
        name=path.name,
        background=BACKGROUND,
        cameras={c.name: c for c in cameras},
        splits=splits,
        lighting=None if lighting is None else "lighting.xml",
    )
    if lighting is not None:
        files.write_text(path / "lighting.xml", f'<scene version="3.0.0">{LIGHTS[lighting]}</scene>')
    writer = CaptureWriter(path, document)
    tint = {None: 1.0, "day": 1.0, "night": 0.6}[lighting]
    for camera, frame in document.images():
        image, mask = draw(body, vertices[FRAMES.index(frame)], document.cameras[camera])
        writer.write(
            camera, frame, np.where(mask[..., None], tint * image, BACKGROUND).astype(np.float32), mask
        )
    writer.finish(body, poses)
    return Capture.read(path)


class Watcher:
    """Ignores progress."""

    def training(self, *_): ...

    def measured(self, *_): ...


def silent(*_):
    """Ignores progress."""


def generate(out: Path) -> None:
    mesh_fit.RATES, mesh_fit.SWEEP_STEPS, mesh_fit.WINDOW_STEPS, mesh_fit.TOLERANCE = (0.03, 0.1), 4, 4, 0.3
    offset_fit.OFFSET_RATES, offset_fit.CONTOUR_SAMPLES = (2e-3, 8e-3), 256
    mesh_fit.MAX_STEPS = 8
    mesh_fit.TextureFit.to_convergence.__defaults__ = (None, 8)

    capture = write_capture(out / "capture")
    plan(capture, PlanSettings(frames=2)).write(out / "plan.json")

    # One run that was stopped halfway, with its state, and the same training without a stop.
    trainer = loop.start(out / "run-stopped", capture, TINY, OPTIONS)
    for _ in range(20):
        trainer.step()
    loop._leave(trainer)
    (out / "run-stopped" / "metrics.jsonl").write_text("")
    loop.train(loop.start(out / "run", capture, TINY, OPTIONS), quiet=True)
    (out / "run" / "state.safetensors").unlink()
    rows = (out / "run" / "metrics.jsonl").read_text().splitlines()
    files.write_json(out / "expected.json", {"stopped_at": 20, "end": json.loads(rows[-1])})
    run = Run.load(out / "run")
    image = ImageRenderer(samples=64)(run.posed(FRAMES[1]), capture.cameras["n0"], geometry=True)
    np.savez_compressed(
        out / "expected.npz",
        linear=image.linear,
        opacity=image.opacity,
        depth=image.depth,
        u=image.u,
        normal=image.normal,
    )

    settings = comparison.Settings(max_images=1, texture=16, samples=16, sequence=2, seconds=0.5)
    comparison.Comparison(out / "run", out / "capture", out / "compare", settings, "ndf-mi compare").run(
        Watcher()
    )

    small = dataclasses.replace(OPTIONS, steps=4)
    Study(
        out / "capture",
        out / "ablation",
        ("no-pose",),
        TINY,
        small,
        AblationSettings(max_images=1, sequence=2, samples=16),
        "ndf-mi ablate",
    ).run(silent, silent)

    known, trained = points.rendering_points, points.variants_of
    points.rendering_points = lambda given: [
        p for p in known(given) if p.key in ("usual", "samples-8", "size-0.5")
    ]
    points.variants_of = lambda *a: [v for v in trained(*a) if v.key in ("own", "width-0.5")]
    study.TradeStudy(
        out / "run",
        out / "capture",
        out / "tradeoff",
        study.Settings(("samples", "size", "width"), steps=4, views=1, timed=1, repeats=2),
        "ndf-mi tradeoff",
    ).run(silent)

    lit = write_capture(out / "day", "day")
    write_capture(out / "night", "night")
    scattering = TrainingOptions(
        steps=6, warm_up=3, rays=64, samples=16, paths=2, max_depth=4, cell=0.03, integrator="prbvolpath"
    )
    loop.train(loop.start(out / "run-scattering", lit, relightable(TINY)[0], scattering), quiet=True)
    relighting.Relighting(
        out / "run-scattering",
        out / "day",
        out / "night",
        out / "relight",
        relighting.Settings(spp=2, texture=8, max_images=1),
        "ndf-mi relight",
    ).run(Watcher())

    shutil.rmtree(out / "tradeoff" / "converged")
    finished = [state for state in out.rglob("state.safetensors") if state.parent.name != "run-stopped"]
    for leftover in (*out.rglob("report.html"), *out.rglob("events.out*"), *out.rglob("*.lock"), *finished):
        leftover.unlink()


if __name__ == "__main__":
    mi.set_log_level(mi.LogLevel.Error)
    machine.describe = lambda: {"Processor": "a processor", "Cores": "2"}
    os.chdir(sys.argv[1])  # the files hold relative paths
    generate(Path("."))
