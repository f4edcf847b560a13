"""Sets the variant for all tests: ``NDF_MI_VARIANT``, or what suits the machine. Small runs for tests."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from ndf_mi import deprecated, variants

variants.use()

if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    # Each worker has its share of the cores, and at least the two threads that Mitsuba's EXR files need.
    import drjit as dr  # after ndf_mi, which picks an LLVM that works

    dr.set_thread_count(max((os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"]), 2))

pytest_plugins = ["sphere_capture", "lit_capture", "limb_capture", "trained_run"]

if TYPE_CHECKING:
    from ndf_mi.body.body import Body
    from ndf_mi.body.poses import Poses
    from ndf_mi.run import Run

RADIUS = 0.3


def uneven(outside: float = 0.08, inside: float = 0.03, least: float = 0.25) -> np.ndarray:
    """(V, 2) float32 widths of a band around the ball, in metres: the largest at x = `RADIUS`, that times
    `least` at the other end, linear in x between them."""
    x = ball(1)[0].template[:, 0].astype(np.float64) / RADIUS
    share = least + (1 - least) * (x - x.min()) / np.ptp(x)
    return (share[:, None] * [outside, inside]).astype(np.float32)


def ball(frames: int = 3) -> tuple[Body, Poses]:
    """A closed ball of radius 0.3 m around the origin with two joints, moved 5 cm a frame along x."""
    import trimesh

    from ndf_mi.body.body import Body
    from ndf_mi.body.poses import Poses

    mesh = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    corners = vertices[faces.ravel()] / RADIUS
    longitude = np.arctan2(corners[:, 0], corners[:, 2]) / (2 * np.pi)
    uv = np.stack([0.5 + longitude, 0.5 + np.arcsin(corners[:, 1]) / np.pi], -1)
    turn = uv[:, 0].reshape(-1, 3)
    turn[(turn.max(1) - turn.min(1) > 0.5)[:, None] & (turn < 0.5)] += 1
    uv = np.clip(np.stack([turn.ravel() / 1.2, uv[:, 1]], -1), 0, 1).astype(np.float32)
    uv_faces = np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    body = Body(faces=faces, uv=uv, uv_faces=uv_faces, template=vertices)
    shift = 0.05 * np.arange(frames, dtype=np.float32)[:, None] * np.array([1, 0, 0], np.float32)
    pose = np.zeros((frames, 2, 3), np.float32)
    pose[:, 1, 2] = 0.3 * np.arange(frames)
    return body, Poses(
        frames=np.arange(frames, dtype=np.int32),
        vertices=vertices + shift[:, None],
        pose=pose,
        root_rotation=np.zeros((frames, 3), np.float32),
        translation=shift,
    )


@pytest.fixture(autouse=True)
def _deprecations_warn_again() -> None:
    """Each test sees the warnings that a process prints once."""
    deprecated.warn.cache_clear()


@pytest.fixture
def make_run(tmp_path: Path) -> Callable[..., Run]:
    """Makes and saves an untrained run around the ball: the preset `tiny` with changes, with widths of the
    band at each vertex if there are any."""
    from ndf_mi.field import preset
    from ndf_mi.run import Run

    def make(name: str = "run", seed: int = 1, frames: int = 3, bands: np.ndarray | None = None,
             **changes: Any) -> Run:
        body, poses = ball(frames)
        changed = dataclasses.replace(preset("tiny"), **changes)
        tensors = {} if bands is None else {"bands": bands}
        run = Run.create(tmp_path / name, changed, body, poses, seed, tensors, background=[0.0, 0.0, 0.0])
        run.save()
        return run

    return make


@pytest.fixture
def make_constant_run(make_run: Callable[..., Run]) -> Callable[..., Run]:
    """Makes a run of constant density (1/m) in the whole band, without fading, and of one sRGB colour."""
    import mitsuba as mi

    def make(
        sigma: float, srgb: tuple[float, float, float] = (0.5, 0.5, 0.5), name: str = "run", **changes: Any
    ) -> Run:
        # The majorant follows the limit: null collisions cost time.
        constant = {"band": 0.08, "band_inside": 0.08, "band_fade": 0.0, "density_limit": 2 * sigma}
        run = make_run(name, **{**constant, **changes})
        field = run.model.field
        weights = run.parameters.weights.numpy()
        p = field.preset
        activation = -p.density_limit * np.log1p(-sigma / p.density_limit) / p.density_gain
        for layer, row, value in (
            ("density_out", 0, np.log(np.expm1(activation)) - p.density_bias),
            *(("colour_out", i, np.log(c / (1 - c))) for i, c in enumerate(srgb)),
        ):
            at = field.layers[layer]
            columns = at.inputs + at.pose
            weights[at.offset + row * columns : at.offset + (row + 1) * columns] = 0
            weights[at.offset + at.outputs * columns + row] = value
        run.parameters = run.parameters.replace(weights=mi.Float(weights))
        run.save()
        return run

    return make
