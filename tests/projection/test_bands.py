"""A band whose width varies over the surface, against brute force in float64."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh

from ndf_mi.errors import InputError
from ndf_mi.projection import Bands, PosedSurface

WIDTHS = (0.02, 0.2)
STEP = 1e-6


def widths(vertices: np.ndarray) -> np.ndarray:
    """(V, 2): wide on one side of the mesh and narrow on the other; three quarters of that inside."""
    share = np.clip(0.5 + 2 * vertices[:, 0], 0, 1)
    outside = WIDTHS[0] + (WIDTHS[1] - WIDTHS[0]) * share
    return np.stack([outside, 0.75 * outside], axis=1).astype(np.float32)


def weights_on(vertices: np.ndarray, faces: np.ndarray, triangle: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(N, 3) barycentric weights of the points of these triangles that are closest to x."""
    corner = vertices[faces[triangle]]
    on = trimesh.triangles.closest_point(corner, x)
    return trimesh.triangles.points_to_barycentric(corner, on, method="cramer")


@pytest.fixture(scope="module")
def posed(mesh: Any) -> PosedSurface:
    surface = mesh.surface()
    return PosedSurface(surface, mi.Float(mesh.vertices.astype(np.float32).ravel()),
                        Bands(surface, widths(mesh.vertices)))


@pytest.fixture(scope="module")
def known(mesh: Any, scatter: Callable, reference: Callable) -> tuple[np.ndarray, ...]:
    """Points, their distances, and how far the band reaches outside of the closest point."""
    x = scatter(mesh, 8000, 0.3)
    distance, triangle = reference(mesh, x)
    weights = weights_on(mesh.vertices, mesh.faces, triangle, x)
    outside = (widths(mesh.vertices)[:, 0][mesh.faces[triangle]] * weights).sum(1)
    return x, distance, outside


def test_a_point_is_in_the_band_of_its_closest_point(posed: Any, known: Any, points: Callable) -> None:
    x, distance, outside = known
    p = posed.project(points(x))
    # Signs are tested without bands. Lanes that are not valid have one only if the search found a triangle.
    wide = PosedSurface(posed.surface, posed.vertices, 0.4).project(points(x))
    assert np.asarray(wide.valid).all()
    edge = np.where(np.asarray(wide.l) < 0, 0.75, 1) * outside
    clear = np.abs(distance - edge) > 1e-5
    valid = np.asarray(p.valid)
    np.testing.assert_array_equal(valid[clear], (distance <= edge)[clear])
    assert 1000 < valid.sum() < 6000 and valid[outside < 0.05].any()
    np.testing.assert_allclose(np.asarray(p.band).T[valid], (outside[:, None] * [1, 0.75])[valid], rtol=1e-4)
    np.testing.assert_allclose(np.abs(np.asarray(p.l))[valid], distance[valid], atol=5e-7)


def test_cells_and_box_hold_all_of_the_band_and_little_else(posed: Any, mesh: Any, known: Any,
                                                            reference: Callable, points: Callable) -> None:
    low, high = np.asarray(posed.bbox.min).ravel(), np.asarray(posed.bbox.max).ravel()
    x = np.random.default_rng(4).uniform(-0.95, 0.95, (20_000, 3)).astype(np.float32)
    distance, triangle = reference(mesh, x.astype(np.float64))
    weights = weights_on(mesh.vertices, mesh.faces, triangle, x.astype(np.float64))
    reach = (widths(mesh.vertices)[:, 0][mesh.faces[triangle]] * weights).sum(1)
    x, distance, reach = (np.concatenate(pair) for pair in zip((x, distance, reach), known, strict=True))
    band, may_contain = distance <= reach, np.asarray(posed.may_contain(points(x)))
    assert may_contain[band].all()
    assert ((x[band] > low) & (x[band] < high)).all()
    # The narrow side is on the left.
    own = widths(mesh.vertices)[:, :1]
    np.testing.assert_allclose(low, (mesh.vertices - own).min(0), atol=1e-3)
    np.testing.assert_allclose(high, (mesh.vertices + own).max(0), atol=1e-3)
    uniform = PosedSurface(posed.surface, posed.vertices, WIDTHS[1])
    assert may_contain.sum() < 0.75 * np.asarray(uniform.may_contain(points(x))).sum()


def test_a_constant_width_is_a_band_of_one_width(mesh: Any, scatter: Callable, points: Callable) -> None:
    surface, x = mesh.surface(), points(scatter(mesh, 5000, 0.2))
    vertices = mi.Float(mesh.vertices.astype(np.float32).ravel())
    bands = Bands(surface, np.full((surface.vertex_count, 2), 0.1))
    one, other = (PosedSurface(surface, vertices, band) for band in (0.1, bands))
    np.testing.assert_array_equal(np.asarray(one.may_contain(x)), np.asarray(other.may_contain(x)))
    a, b = one.project(x), other.project(x)
    valid = np.asarray(a.valid)
    # Sums of weights round.
    clear = np.abs(np.abs(np.asarray(a.l)) - 0.1) > 1e-6
    np.testing.assert_array_equal(valid[clear], np.asarray(b.valid)[clear])
    np.testing.assert_array_equal(np.asarray(a.l)[valid], np.asarray(b.l)[valid])


def test_gradients_of_the_widths(mesh: Any, posed: Any, known: Any, points: Callable,
                                 reference: Callable) -> None:
    """Of a random functional, against central differences in float64 that stay on the triangle found."""
    x, distance, outside = (a[:600] for a in known)
    triangle = reference(mesh, x)[1]
    weights = weights_on(mesh.vertices, mesh.faces, triangle, x)
    clear = (distance < 0.7 * outside) & ((weights > 0.02) | (weights == 0)).all(1)
    x, triangle = x[clear], triangle[clear]
    assert len(x) > 100
    rng = np.random.default_rng(8)
    seed = rng.normal(size=len(x))
    own = widths(mesh.vertices)[:, 0].astype(np.float64)[mesh.faces[triangle]]

    def functional(vertices: np.ndarray, x: np.ndarray) -> np.ndarray:
        return seed * (own * weights_on(vertices, mesh.faces, triangle, x)).sum(1)

    vertices, query = mi.Float(mesh.vertices.astype(np.float32).ravel()), points(x)
    dr.enable_grad(vertices, query)
    moved = PosedSurface(posed.surface, vertices, Bands(posed.surface, widths(mesh.vertices)))
    dr.backward(dr.sum(moved.project(query).band.x * mi.Float(seed.astype(np.float32))))
    found = np.asarray(dr.grad(query)).T
    for axis in range(3):
        step = STEP * np.eye(3)[axis]
        expected = (functional(mesh.vertices, x + step) - functional(mesh.vertices, x - step)) / (2 * STEP)
        np.testing.assert_allclose(found[:, axis], expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())
    slopes = np.asarray(dr.grad(vertices)).reshape(-1, 3)
    for _ in range(5):
        way = rng.normal(size=mesh.vertices.shape)
        ahead, behind = (functional(mesh.vertices + s * STEP * way, x).sum() for s in (1, -1))
        assert abs((slopes * way).sum() - (ahead - behind) / (2 * STEP)) < 3e-3 * np.linalg.norm(slopes * way)


@pytest.mark.parametrize(("change", "where"), [
    (lambda w: w[:-1], "bands"), (lambda w: w[:, 0], "bands"),
    (lambda w: np.where(np.arange(len(w))[:, None] == 7, 0, w), "vertex 7"),
    (lambda w: np.where(np.arange(len(w))[:, None] == 3, np.nan, w), "vertex 3"),
])
def test_wrong_widths_are_named(mesh: Any, change: Callable, where: str) -> None:
    with pytest.raises(InputError, match=where):
        Bands(mesh.surface(), change(widths(mesh.vertices)))
