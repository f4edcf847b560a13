"""Majorants of densities, and free flights where a density equals its bound."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.render.nested import Majorants
from ndf_mi.render.replay import Replay
from ndf_mi.stability.ball import PEAK, Ridge, ridge
from ndf_mi.stability.case import Check, case, error


@pytest.fixture(scope="module")
def dense_ball() -> Iterator[Ridge]:
    """A ridge whose limit and weights the tests change."""
    with ridge() as found:
        yield found


@case(
    "majorants against densities: from samples between nested shells, up to densities at their very limit",
    "limits of 1e-2 to 1e5 per metre", primal=0.0, gradient=None,
    relative_to="no density reaches its majorant")
@pytest.mark.parametrize("peak", [PEAK, 30.0], ids=["below it", "at the limit"])
@pytest.mark.parametrize("limit", [1e-2, 1.0, 1e3, 1e5], ids="{:g}".format)
def test_majorants(
    check: Check, dense_ball: Ridge, monkeypatch: pytest.MonkeyPatch, limit: float, peak: float) -> None:
    """The density's formula at random points of the band against the majorant of their layer."""
    model = dense_ball.run.model
    monkeypatch.setattr(
        model.field, "preset",
        dataclasses.replace(model.field.preset, density_limit=limit, density_gain=limit / 3))
    weights = dense_ball.run.parameters.weights.numpy()
    weights[dense_ball.peak] = peak
    dense_ball.set_weights(weights)
    found = Majorants(model, dense_ball.run.posed(0), mi.Float(dense_ball.vertices.ravel()), 3, 0.05)
    rng = np.random.default_rng(6)
    way = rng.normal(size=(2000, 3))
    points = (way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(0.25, 0.38, (2000, 1))).astype(
        np.float32)
    # Distances come from the projection, which has cases of its own.
    l = (
        dense_ball.run.surface(0) .project(mi.Point3f(np.ascontiguousarray(points.T))) .l.numpy()
        .astype(np.float64))
    layer = found.layers.locate(points)
    sigma = dense_ball.density(l, peak)
    above = np.where(
        layer >= 0, sigma / np.array(found.values)[layer] - 1, np.where(sigma > 1e-6 * limit, np.inf, -1))
    equal = np.where((sigma > 0) & (above == 0), 1.0, 0.0)
    check(max(0.0, float(above.max()), float(equal.max())))


NODES, CELL = 8, 0.2


@pytest.fixture(scope="module")
def cube() -> tuple[mi.Medium, Replay]:
    """A medium on a grid, that fills a cube of edge 1, and paths through it by prbvolpath."""
    medium = mi.load_dict({"type": "ndf_grid", "nx": NODES, "ny": NODES, "nz": NODES, "cell": CELL})
    to_world = mi.ScalarTransform4f().scale(0.5)
    scene = mi.load_dict(
        {
            "type": "scene",
            "cube": {"type": "cube", "to_world": to_world, "bsdf": {"type": "null"}, "interior": medium}}
    )
    return medium, Replay(
        scene, mi.load_dict({"type": "prbvolpath", "max_depth": 8, "hide_emitters": True}), mi.Color3f(1.0))


@pytest.mark.long
@case(
    "a medium on a grid that is everywhere as dense as its densest node: transmittance and gradient by "
    "prbvolpath", "optical depths of 1e-3 to 8", primal=5.0, gradient=5.0,
    relative_to="the standard error of the mean of 16 × 4096 paths")
@pytest.mark.parametrize("tau", [1e-3, 1e-2, 0.1, 1.0, 3.0, 8.0], ids="{:g}".format)
def test_majorant_equals_density(check: Check, cube: tuple[mi.Medium, Replay], tau: float) -> None:
    """Gradients need a majorant strictly above the density: it is 1.05 times the densest node."""
    medium, replay = cube
    paths = 4096
    ray = mi.Ray3f(
        mi.Point3f(dr.full(mi.Float, 0.1, paths), 0.05, -2.0),
        mi.Vector3f(dr.zeros(mi.Float, paths), 0.0, 1.0))
    values = np.zeros((NODES**3, 4), np.float32)
    values[:, 0] = tau
    flat = mi.Float(values.ravel())
    dr.enable_grad(flat)
    medium.fill(flat, mi.Point3f(-0.5 * CELL * (NODES - 1)), mi.Float(tau))
    through, slopes = [], []
    for seed in range(16):
        radiance = replay.radiance(ray, seed)
        through.append(float(dr.mean(radiance.x)[0]))
        dr.set_grad(flat, 0)
        replay.backward(ray, seed, radiance, mi.Color3f(1 / paths, 0, 0))
        slopes.append(float(dr.grad(flat).numpy().reshape(-1, 4)[:, 0].astype(np.float64).sum()))
    noise, slope_noise = (max(float(np.std(v, ddof=1)) / 4, 1e-7) for v in (through, slopes))
    check(error(np.mean(through), np.exp(-tau), noise), error(np.mean(slopes), -np.exp(-tau), slope_noise))
