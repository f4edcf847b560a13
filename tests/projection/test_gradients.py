"""First derivatives against central differences of a float64 reference that searches again at every step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh

from ndf_mi.projection import PosedSurface

STEP = 1e-6


def reference(vertices: np.ndarray, mesh: Any, triangle: np.ndarray,
              x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unsigned distance and texture coordinates of the closest point on the given triangles, in float64."""
    corner = vertices[mesh.faces[triangle]]
    on = trimesh.triangles.closest_point(corner, x)
    weights = trimesh.triangles.points_to_barycentric(corner, on, method="cramer")
    uv = (mesh.uv[mesh.uv_faces[triangle]].astype(np.float64) * weights[:, :, None]).sum(1)
    return np.linalg.norm(x - on, axis=1), uv


@pytest.fixture(scope="module")
def case(mesh: Any, scatter: Callable, points: Callable) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points off the surface, their triangles and the signs of their distances; none close to a change of
    region."""
    x = scatter(mesh, 600, 0.12, seed=7)
    p = mesh.pose().project(points(x))
    weights = np.asarray(p.barycentric).T
    clear = (np.abs(np.asarray(p.l)) > 0.01) & ((weights > 0.02) | (weights == 0)).all(1)
    assert clear.sum() > 200 and (weights[clear] == 0).any()
    return x[clear], np.asarray(p.triangle)[clear], np.sign(np.asarray(p.l))[clear]


def outputs(p: Any, seeds: tuple[np.ndarray, np.ndarray]) -> mi.Float:
    """A random linear functional of l and uv."""
    return dr.sum(p.l * mi.Float(seeds[0]) + p.uv.x * mi.Float(seeds[1][:, 0]) + p.uv.y
                  * mi.Float(seeds[1][:, 1]))


def seeds(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(8)
    return rng.normal(size=count).astype(np.float32), rng.normal(size=(count, 2)).astype(np.float32)


def test_gradient_with_respect_to_the_query(mesh: Any, case: Any, points: Callable) -> None:
    x, triangle, sign = case
    wl, wuv = seeds(len(x))
    query = points(x)
    dr.enable_grad(query)
    dr.backward(outputs(mesh.pose().project(query), (wl, wuv)))
    found = np.asarray(dr.grad(query)).T
    expected = np.zeros_like(x)
    for axis in range(3):
        step = STEP * np.eye(3)[axis]
        high, low = (reference(mesh.vertices, mesh, triangle, x + s) for s in (step, -step))
        expected[:, axis] = (wl * sign * (high[0] - low[0]) + (wuv * (high[1] - low[1])).sum(1)) / (2 * STEP)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-4 * np.abs(expected).max())


def test_gradient_with_respect_to_the_vertices_in_random_directions(mesh: Any, case: Any,
                                                                    points: Callable) -> None:
    x, triangle, sign = case
    wl, wuv = seeds(len(x))
    vertices = mi.Float(mesh.vertices.astype(np.float32).ravel())
    dr.enable_grad(vertices)
    posed = PosedSurface(mesh.surface(), vertices, 0.2)
    dr.backward(outputs(posed.project(points(x)), (wl, wuv)))
    gradient = np.asarray(dr.grad(vertices)).reshape(-1, 3)
    rng = np.random.default_rng(9)
    for _ in range(5):
        way = rng.normal(size=mesh.vertices.shape)
        high, low = (reference(mesh.vertices + s * STEP * way, mesh, triangle, x) for s in (1, -1))
        expected = ((wl * sign * (high[0] - low[0])).sum() + (wuv * (high[1] - low[1])).sum()) / (2 * STEP)
        terms = np.linalg.norm(gradient * way)
        assert abs((gradient * way).sum() - expected) < 2e-3 * terms


def test_on_the_surface_the_gradient_is_the_normal(mesh: Any, points: Callable) -> None:
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for x, normal in ((solid.triangles_center, solid.face_normals), (mesh.vertices, None)):
        query = points(x)
        dr.enable_grad(query)
        p = mesh.pose().project(query)
        dr.backward(dr.sum(p.l))
        gradient = np.asarray(dr.grad(query)).T
        np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, atol=1e-5)
        if normal is not None:
            np.testing.assert_allclose(gradient, normal, atol=1e-5)


@pytest.mark.parametrize("third", [[1.0, 0, 0], [0.5, 0, 0], [0.5, 1e-8, 0], [0, 0, 0], [0.5, 1e-4, 0]])
def test_slivers_have_finite_gradients(third: list[float], chart: Callable, points: Callable) -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], third, [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    flat = chart(vertices, np.array([[0, 1, 2], [3, 4, 5]]))
    rng = np.random.default_rng(10)
    x = rng.uniform(-0.3, 0.3, (200, 3)) + [0.5, 0, 0]
    x = np.concatenate([x, vertices, [[0.5, 0, 0], [0.25, 0, 0]]])
    start = mi.Float(vertices.astype(np.float32).ravel())
    query = points(x)
    dr.enable_grad(start, query)
    p = PosedSurface(flat.surface(), start, 0.5).project(query)
    dr.backward(dr.sum(p.l + p.uv.x - 2 * p.uv.y + p.point.x + p.barycentric.z))
    assert np.isfinite(np.asarray(dr.grad(start))).all() and np.isfinite(np.asarray(dr.grad(query))).all()
    assert np.isfinite(np.asarray(p.l)).all() and np.isfinite(np.asarray(p.uv)).all()


def test_inactive_lanes_pass_no_gradient(mesh: Any, scatter: Callable, points: Callable) -> None:
    x = scatter(mesh, 32, 0.1)
    x[::2] = np.inf
    query = points(x)
    dr.enable_grad(query)
    p = mesh.pose().project(query, mi.Bool(np.arange(32) % 2 == 1))
    dr.backward(dr.sum(p.l + p.uv.x + p.point.y))
    gradient = np.asarray(dr.grad(query)).T
    assert (gradient[::2] == 0).all() and (gradient[1::2] != 0).any(1).all()
