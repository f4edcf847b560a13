"""Compositing against double precision in NumPy and against Mitsuba's own integrator."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from sphere_capture import ring_camera

from ndf_mi.methods.gaussians.compositing import Posed, composite
from ndf_mi.methods.gaussians.hits import Rectangle, find_hits
from ndf_mi.methods.gaussians.scene import ellipsoids

COUNT = 60
PART = Rectangle(ring_camera("c", 0.3, size=24), 2, 3, 20, 18)


def cloud(seed: int = 0, scale: float = 0.06) -> dict[str, np.ndarray]:
    """(k, N) float32 arrays of primitives around the origin."""
    rng = np.random.default_rng(seed)
    rotation = rng.normal(size=(4, COUNT))
    values = {
        "centre": rng.uniform(-0.5, 0.5, (3, COUNT)), "scale": scale * rng.uniform(0.6, 1.4, (3, COUNT)),
        "rotation": rotation / np.linalg.norm(rotation, axis=0), "opacity": rng.uniform(0.2, 0.95, COUNT),
        "colour": rng.random((3, COUNT))}
    return {name: value.astype(np.float32) for name, value in values.items()}


def as_posed(values: dict[str, np.ndarray]) -> Posed:
    kinds = {"centre": mi.Point3f, "scale": mi.Vector3f, "rotation": mi.Quaternion4f, "opacity": mi.Float,
             "colour": mi.Color3f}
    return Posed(**{name: kinds[name](value) for name, value in values.items()})


def rays() -> tuple[mi.Point3f, mi.Vector3f]:
    origin, direction = (np.asarray(values, np.float32) for values in PART.rays())
    return mi.Point3f(origin), mi.Vector3f(direction)


def composited(posed: Posed) -> tuple[mi.Color3f, mi.Float]:
    origin, direction = rays()
    return composite(posed, find_hits(posed, [PART], origin, direction), origin, direction)


def exact(values: dict[str, np.ndarray], index: int) -> np.ndarray:
    """Colour and opacity that one ray sees, (4,) in double precision."""
    origin, direction = (part[:, index] for part in PART.rays())
    v = {name: value.astype(np.float64) for name, value in values.items()}
    x, y, z, w = v["rotation"]
    turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    local = [np.einsum("jin,j...n->in", turn, side) / v["scale"]
             for side in (origin[:, None] - v["centre"], np.repeat(direction[:, None], COUNT, 1))]
    a, b, c = (local[1]**2).sum(0), (local[0] * local[1]).sum(0), (local[0]**2).sum(0) - 9
    met = np.flatnonzero(b * b - a * c > 0)
    entry = (-b - np.sqrt(np.maximum(b * b - a * c, 0))) / a
    seen, transmittance = np.zeros(4), 1.0
    for i in met[np.argsort(entry[met])]:
        distance = ((local[0][:, i] - local[1][:, i] * b[i] / a[i])**2).sum()
        alpha = min(v["opacity"][i] * np.exp(-distance / 2), 0.9999)
        seen += transmittance * alpha * np.append(v["colour"][:, i], 1)
        transmittance *= 1 - alpha
        if transmittance <= 0.01:
            break
    return seen


def test_colours_and_opacities_are_those_of_double_precision():
    values = cloud()
    colour, opacity = composited(as_posed(values))
    found = np.concatenate([np.array(colour), [np.array(opacity)]]).T
    expected = np.array([exact(values, index) for index in range(len(found))])
    assert expected[:, 3].max() > 0.9 and expected[:, 3].min() == 0
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_small_primitives_far_away_are_as_exact():
    values = cloud(1, scale=0.003)
    # Near rays: most of them see none.
    origin, direction = PART.rays()
    rng = np.random.default_rng(7)
    chosen = rng.choice(direction.shape[1], COUNT // 4).repeat(4)
    values["centre"] = (origin[:, chosen] + direction[:, chosen] * rng.uniform(2, 2.4, COUNT)
                        + rng.normal(0, 0.002, (3, COUNT))).astype(np.float32)
    colour, opacity = composited(as_posed(values))
    found = np.concatenate([np.array(colour), [np.array(opacity)]]).T
    expected = np.array([exact(values, index) for index in range(len(found))])
    assert (expected[:, 3] > 0.5).sum() > 8
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_values_and_gradients_are_those_of_mitsuba():
    # Balls of a third of a unit across: the case in which Mitsuba's intersections are exact.
    values = cloud(2)
    values["scale"][:] = 1 / 3
    scaled = 5.0
    values["centre"] *= scaled
    part = dataclasses.replace(PART, camera=dataclasses.replace(
        PART.camera, transform=np.diag([1, 1, 1, 1 / scaled]) @ PART.camera.transform * [1, 1, 1, scaled]))
    origin, direction = (np.asarray(side, np.float32) for side in part.rays())
    origin = origin * np.float32(1)
    ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction))
    adjoint = np.random.default_rng(3).normal(size=direction.shape).astype(np.float32)

    posed = as_posed(values)
    leaves = {name: getattr(posed, name) for name in values}
    dr.enable_grad(leaves)
    colour, _ = composite(posed, find_hits(posed, [part], ray.o, ray.d), ray.o, ray.d)
    dr.backward(dr.sum(dr.dot(colour, mi.Color3f(adjoint))))

    scene = mi.load_dict({"type": "scene", "primitives": ellipsoids(posed)})
    parameters = mi.traverse(scene)
    names = [f"primitives.{name}" for name in ("data", "opacities", "sh_coeffs")]
    for name in names:
        dr.enable_grad(parameters[name])
    parameters.update()
    integrator = mi.load_dict({"type": "volprim_rf_basic", "srgb_primitives": False})
    sampler = mi.load_dict({"type": "independent"})

    def sample(mode: dr.ADMode, δL: object, state: object) -> tuple:
        sampler.seed(0, dr.width(ray.d))
        with dr.suspend_grad():
            return integrator.sample(mode=mode, scene=scene, sampler=sampler, ray=ray, depth=mi.UInt32(0),
                                     δL=δL, state_in=state, active=mi.Bool(True))

    radiance, _, _, state = sample(dr.ADMode.Primal, None, None)
    np.testing.assert_allclose(np.array(colour), np.array(radiance), atol=2e-3)
    sample(dr.ADMode.Backward, mi.Spectrum(adjoint), state)
    data, opacity, harmonics = (dr.grad(parameters[name]).numpy() for name in names)
    data = data.reshape(-1, 10).T
    expected = {"centre": data[:3], "scale": data[3:6], "opacity": opacity.ravel(),
                "colour": harmonics.reshape(-1, 3).T / 0.28209479177387814}
    for name, gradient in expected.items():
        own = np.array(dr.grad(leaves[name]))
        assert np.linalg.norm(own - gradient) < 0.02 * np.linalg.norm(gradient), name


def test_gradients_are_finite_differences():
    values = cloud(4)
    adjoint = np.random.default_rng(5).normal(size=(4, PART.width * PART.height)).astype(np.float32)

    def total(changed: dict[str, np.ndarray]) -> float:
        seen = np.array([exact(changed, index) for index in range(adjoint.shape[1])])
        return float((seen.T * adjoint).sum())

    posed = as_posed(values)
    leaves = {name: getattr(posed, name) for name in values}
    dr.enable_grad(leaves)
    colour, opacity = composited(posed)
    dr.backward(dr.sum(dr.dot(colour, mi.Color3f(adjoint[:3])) + opacity * mi.Float(adjoint[3])))
    # What changes which primitives a ray meets makes steps; the opacity does not.
    direction = np.random.default_rng(6).normal(size=COUNT).astype(np.float32)
    step = 1e-3
    ends = [total({**values, "opacity": values["opacity"] + change}) for change in
            (step * direction, -step * direction)]
    slope = (ends[0] - ends[1]) / (2 * step)
    own = float(dr.sum(dr.grad(leaves["opacity"]) * mi.Float(direction))[0])
    assert own == pytest.approx(slope, rel=0.02)
    assert own == pytest.approx(slope, rel=0.02)
