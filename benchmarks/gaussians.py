"""Gaussian primitives on a body, by Mitsuba's own shapes and integrator and by this package.

    python benchmarks/gaussians.py CAPTURE --spacing 0.015

Covers the body of the first training frame with flat primitives of random colours, and takes the rays of all
training views of it. Prints for Mitsuba's `ellipsoids` and `ellipsoidsmesh` under `volprim_rf_basic` the time
of a picture, of its gradients, and of moving the primitives; the same for this package; and for both how far
the pictures are from one in double precision.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from ndf_mi import variants

variants.use()

import drjit as dr  # noqa: E402
import mitsuba as mi  # noqa: E402

from ndf_mi.capture.capture import Capture  # noqa: E402
from ndf_mi.methods.gaussians.compositing import EXTENT, MOST_OPAQUE, Y00, Posed, composite  # noqa: E402
from ndf_mi.methods.gaussians.hits import MIN_TRANSMITTANCE, Rectangle, find_hits  # noqa: E402
from ndf_mi.methods.gaussians.primitives import LEARNED, LIGHT, Rig, initial, pose, rows, spread  # noqa: E402
from ndf_mi.surface.rest_frames import RestFrames  # noqa: E402
from ndf_mi.surface.training_views import TrainingViews  # noqa: E402

REPEATS = 4


def main(capture: Annotated[Path, tyro.conf.Positional], spacing: float = 0.015) -> None:
    """Compares speed and exactness.

    Args:
        capture: folder of the capture.
        spacing: metres between primitives.
    """
    known = Capture.read(capture)
    frame = known.splits["train"].frames[0]
    views = TrainingViews(known, 0, [frame], 0.06)
    parts = [Rectangle(camera, *rectangle) for camera, rectangle, _ in views.next()[1]]
    rng = np.random.default_rng(0)
    rig = Rig(known.body.faces, known.poses, RestFrames(known).vertices)
    binding = spread(known.poses.vertices[known.poses.index(frame)], rig.faces, spacing, rng)
    learned = initial(len(binding), np.full(3, 0.5), rng)
    learned["colour"] = rng.random(learned["colour"].shape).astype(np.float32)
    flat = {name: mi.Float(learned[name].ravel()) for name in LEARNED}
    sides = [np.concatenate(values, 1) for values in zip(*(part.rays() for part in parts), strict=True)]
    ray = mi.Ray3f(mi.Point3f(sides[0].astype(np.float32)), mi.Vector3f(sides[1].astype(np.float32)))
    posed = pose(rows(flat), mi.Float([0.0] * LIGHT), rig.frames(binding, frame), spacing, 1e-4)
    dr.eval(posed)
    print(f"{len(binding)} primitives, {dr.width(ray.d)} rays, {dr.thread_count()} threads")
    some = np.arange(0, dr.width(ray.d), 23)
    exact = np.array([exact_colour(posed, sides[0][:, i], sides[1][:, i]) for i in some])

    def report(name: str, picture: np.ndarray, **seconds: float) -> None:
        error = np.abs(picture[some] - exact).max(1)[exact.any(1)]
        times = ", ".join(f"{part} {value:.3f} s" for part, value in seconds.items())
        print(f"{name}: {times}; off by more than 0.01 at {(error > 0.01).mean():.1%} of the pixels of "
              f"primitives, root mean square {np.sqrt((error**2).mean()):.4f}")

    for kind in ("ellipsoids", "ellipsoidsmesh"):
        picture, seconds = _mitsuba(kind, posed, ray)
        report(kind, picture, **seconds)
    leaves = (posed.centre, posed.scale, posed.rotation, posed.opacity, posed.colour)
    dr.enable_grad(leaves)
    finding, hits = _timed(lambda: find_hits(posed, parts, ray.o, ray.d))

    def gradients() -> np.ndarray:
        colour, _ = composite(posed, hits, ray.o, ray.d)
        dr.backward(dr.sum(dr.squared_norm(colour - 0.3)))
        dr.eval(dr.grad(leaves))
        return np.array(colour).T

    compositing, picture = _timed(gradients)
    report("this package", picture, **{"hits": finding, "render and gradients": compositing})


def exact_colour(posed: Posed, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(3,) what one ray sees, in double precision."""
    centre, scale, colour = (np.array(v, np.float64) for v in (posed.centre, posed.scale, posed.colour))
    turn = np.array(dr.quat_to_matrix(mi.Matrix3f, posed.rotation), np.float64)
    start = np.einsum("jin,jn->in", turn, origin[:, None] - centre) / scale
    step = np.einsum("jin,j->in", turn, direction) / scale
    a, b = (step**2).sum(0), (start * step).sum(0)
    distance = ((start - step * (b / a))**2).sum(0)
    met = np.flatnonzero(distance < EXTENT**2)
    entry = -b[met] / a[met] - np.sqrt((EXTENT**2 - distance[met]) / a[met])
    seen, transmittance = np.zeros(3), 1.0
    for i in met[np.argsort(entry)]:
        alpha = min(np.array(posed.opacity)[i] * np.exp(-distance[i] / 2), MOST_OPAQUE)
        seen += transmittance * alpha * colour[:, i]
        transmittance *= 1 - alpha
        if transmittance <= MIN_TRANSMITTANCE:
            break
    return seen


def _mitsuba(kind: str, posed: Posed, ray: mi.Ray3f) -> tuple[np.ndarray, dict[str, float]]:
    def columns(values: Any) -> mi.TensorXf:
        return mi.TensorXf(np.ascontiguousarray(np.atleast_2d(np.array(values)).T, np.float32))

    shape = {"type": kind, "centers": columns(posed.centre), "scales": columns(posed.scale),
             "quaternions": columns(posed.rotation), "opacities": columns(posed.opacity),
             "sh_coeffs": columns((posed.colour - 0.5) / Y00)}
    scene = mi.load_dict({"type": "scene", "primitives": shape})
    parameters = mi.traverse(scene)
    integrator = mi.load_dict({"type": "volprim_rf_basic", "srgb_primitives": False})
    sampler = mi.load_dict({"type": "independent"})
    names = [f"primitives.{name}" for name in ("data", "opacities", "sh_coeffs")]

    def sample(mode: dr.ADMode, adjoint: Any, state: Any) -> Any:
        sampler.seed(0, dr.width(ray.d))
        with dr.suspend_grad():
            found = integrator.sample(mode=mode, scene=scene, sampler=sampler, ray=ray, depth=mi.UInt32(0),
                                      δL=adjoint, state_in=state, active=mi.Bool(True))
            dr.eval(found[0], found[3])
        return found

    def move() -> None:
        parameters["primitives.data"] = mi.Float(parameters["primitives.data"].numpy().ravel())
        parameters.update()

    moving, _ = _timed(move)
    picture, (radiance, _, _, state) = _timed(lambda: sample(dr.ADMode.Primal, None, None))
    for name in names:
        dr.enable_grad(parameters[name])

    def backward() -> None:
        sample(dr.ADMode.Backward, mi.Spectrum(radiance - 0.3), state)
        dr.eval([dr.grad(parameters[name]) for name in names])

    gradients, _ = _timed(backward)
    return np.array(radiance).T, {"render": picture, "gradients": gradients, "move": moving}


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """The shortest of a few times, and the last result."""
    times = []
    for _ in range(REPEATS):
        dr.sync_thread()
        start = time.perf_counter()
        found = work()
        dr.sync_thread()
        times.append(time.perf_counter() - start)
    return min(times), found


if __name__ == "__main__":
    tyro.cli(main)
