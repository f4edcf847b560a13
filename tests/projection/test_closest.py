"""Values: distance, sign, point, texture coordinates, validity."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh

from ndf_mi.body.anny import load_anny
from ndf_mi.projection import PosedSurface, Surface


def values(p: Any) -> dict[str, np.ndarray]:
    return {
        name: np.asarray(getattr(p, name)).T
        for name in ("uv", "l", "triangle", "barycentric", "point", "normal", "valid")
    }


def test_distance_is_that_of_brute_force_in_float64(
    mesh: Any, scatter: Callable, reference: Callable, points: Callable
) -> None:
    x = scatter(mesh, 6000, 0.3)
    band = 0.2
    distance, _ = reference(mesh, x)
    p = values(mesh.pose(band).project(points(x)))
    clear = np.abs(distance - band) > 1e-5
    np.testing.assert_array_equal(p["valid"][clear], distance[clear] <= band)
    inside = p["valid"].astype(bool)
    assert 1000 < inside.sum() < 5900
    np.testing.assert_allclose(np.abs(p["l"][inside]), distance[inside], atol=5e-7)
    np.testing.assert_allclose(np.linalg.norm(x - p["point"], axis=1)[inside], distance[inside], atol=5e-7)
    assert (p["triangle"][~inside & (distance > band + 1e-3)] == 0).all()


def test_sorted_and_unsorted_searches_agree(mesh: Any, scatter: Callable, points: Callable) -> None:
    x = points(scatter(mesh, 5000, 0.25))
    posed = mesh.pose(0.2)
    whole = values(posed.project(x))
    part = values(posed.project(dr.gather(mi.Point3f, x, dr.arange(mi.UInt32, 500))))
    for name in ("l", "point", "valid"):
        np.testing.assert_allclose(part[name], whole[name][:500], atol=1e-7)


def test_inactive_lanes_are_finite_and_not_valid(mesh: Any, scatter: Callable, points: Callable) -> None:
    x = scatter(mesh, 64, 0.1)
    x[::2] = np.nan
    active = mi.Bool(np.arange(64) % 2 == 1)
    p = values(mesh.pose().project(points(x), active))
    np.testing.assert_array_equal(p["valid"], np.arange(64) % 2 == 1)
    assert all(np.isfinite(value.astype(float)).all() for value in p.values())


def test_far_from_the_origin_nothing_is_lost(
    mesh: Any, chart: Callable, scatter: Callable, reference: Callable, points: Callable
) -> None:
    away = np.array([512.0, -300.0, 1024.0])
    moved = chart((mesh.vertices + away).astype(np.float32).astype(np.float64), mesh.faces)
    x = scatter(moved, 1000, 0.15)
    distance, _ = reference(moved, x)
    p = values(moved.pose().project(points(x)))
    assert p["valid"].all()
    np.testing.assert_allclose(np.abs(p["l"]), distance, atol=2e-6)


def box_sdf(x: np.ndarray, half: np.ndarray) -> np.ndarray:
    q = np.abs(x) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)


def test_signed_distance_of_a_box_in_closed_form(chart: Callable, points: Callable) -> None:
    half = np.array([0.3, 0.2, 0.1])
    box = trimesh.creation.box(2 * half)
    rng = np.random.default_rng(1)
    x = rng.uniform(-0.5, 0.5, (4000, 3)).astype(np.float32)
    # points straight off faces, edges and corners, where ties between triangles are decided
    special = np.array([[sx, sy, sz] for sx in (-1, 0, 1) for sy in (-1, 0, 1) for sz in (-1, 0, 1)]) * half
    x = np.concatenate([x, special * 1.2, special * 0.8]).astype(np.float32)
    p = values(chart(box.vertices, box.faces).pose(0.6).project(points(x)))
    np.testing.assert_allclose(p["l"], box_sdf(x.astype(np.float64), half), atol=3e-7)
    assert p["valid"].all()


def test_sign_at_a_sharp_corner(chart: Callable, points: Callable) -> None:
    # a needle: near its tip the plane of the nearest triangle alone would give wrong signs
    vertices = np.array([[0, 0, 0], [0.02, 0, -1], [-0.01, 0.3, -1], [-0.01, -0.02, -1]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    tetrahedron = trimesh.Trimesh(vertices, faces, process=False)
    assert tetrahedron.volume > 0
    rng = np.random.default_rng(2)
    x = (rng.normal(size=(4000, 3)) * [0.05, 0.15, 0.1] + rng.choice(4, 4000)[:, None] / 4
         * [[0, 0.1, -1]]).astype(
        np.float32
    )
    normal = tetrahedron.face_normals
    outside = np.einsum("nk,fk->nf", x, normal) - np.einsum("fk,fk->f", vertices[faces[:, 0]], normal)
    p = values(chart(vertices, faces).pose(2.0).project(points(x)))
    clear = np.abs(outside.max(1)) > 1e-6
    np.testing.assert_array_equal((p["l"] < 0)[clear], (outside.max(1) < 0)[clear])


def test_uv_gives_the_point_back_at_every_seam(mesh: Any, scatter: Callable, points: Callable) -> None:
    rng = np.random.default_rng(3)
    edges = mesh.faces[rng.integers(len(mesh.faces), size=500)]
    on_edges = 0.5 * (mesh.vertices[edges[:, 0]] + mesh.vertices[edges[:, 1]])
    x = np.concatenate([scatter(mesh, 2000, 0.1), on_edges * 1.05, mesh.vertices * 1.05])
    p = values(mesh.pose().project(points(x)))
    valid = p["valid"].astype(bool)
    triangle, point = mesh.point_of_uv(p["uv"][valid].astype(np.float64))
    np.testing.assert_array_equal(triangle, p["triangle"][valid])
    np.testing.assert_allclose(point, p["point"][valid], atol=5e-6)
    again = (mesh.vertices[mesh.faces[triangle]] * p["barycentric"][valid][:, :, None]).sum(1)
    np.testing.assert_allclose(again, p["point"][valid], atol=5e-7)


def test_on_the_surface(mesh: Any, points: Callable) -> None:
    centre = mesh.vertices[mesh.faces].mean(1)
    p = values(mesh.pose().project(points(centre)))
    assert p["valid"].all()
    np.testing.assert_allclose(p["l"], 0, atol=1e-7)
    np.testing.assert_array_equal(p["triangle"], np.arange(len(mesh.faces)))
    normal = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    np.testing.assert_allclose(p["normal"], normal, atol=1e-5)


def test_near_and_box_leave_nothing_out(mesh: Any, reference: Callable, points: Callable) -> None:
    band = 0.1
    posed = mesh.pose(band)
    x = np.random.default_rng(4).uniform(-0.9, 0.9, (5000, 3)).astype(np.float32)
    distance, _ = reference(mesh, x.astype(np.float64))
    near = np.asarray(posed.may_contain(points(x)))
    assert near[distance <= band].all()
    assert not near[distance > 2 * band].any()
    low, high = np.asarray(posed.bbox.min).ravel(), np.asarray(posed.bbox.max).ravel()
    assert ((mesh.vertices.min(0) - band > low) & (mesh.vertices.min(0) - 1.05 * band < low)).all()
    assert ((mesh.vertices.max(0) + band < high) & (mesh.vertices.max(0) + 1.05 * band > high)).all()


@pytest.mark.parametrize("size", [1e-3, 1.0, 50.0])
def test_a_lone_triangle_of_any_size(size: float, chart: Callable, points: Callable) -> None:
    vertices = size * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    posed = chart(vertices, np.array([[0, 1, 2]])).pose(0.5)
    x = np.array([[0.2 * size, 0.2 * size, 0.1], [0.2 * size, 0.2 * size, -0.1], [-0.1, 0, 0],
                  [size + 0.1, -0.1, 0]])
    p = values(posed.project(points(x)))
    np.testing.assert_allclose(p["l"][:2], [0.1, -0.1], rtol=1e-5)
    np.testing.assert_allclose(np.abs(p["l"][2:]), [0.1, np.sqrt(0.02)], rtol=1e-5, atol=4e-6 * size)


def test_open3d_agrees_on_the_body(chart: Callable, points: Callable) -> None:
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    body = load_anny()
    vertices = np.asarray(body.template, np.float32)
    posed = PosedSurface(Surface(body.faces, body.uv, body.uv_faces, vertices), mi.Float(vertices.ravel()),
                         0.08)
    rng = np.random.default_rng(6)
    x = rng.uniform(vertices.min(0) - 0.08, vertices.max(0) + 0.08, (200_000, 3)).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices, np.asarray(body.faces, np.uint32))
    distance = scene.compute_distance(o3d.core.Tensor(x)).numpy()
    p = posed.project(points(x))
    valid = np.asarray(p.valid)
    np.testing.assert_array_equal(
        valid[np.abs(distance - 0.08) > 1e-5], (distance <= 0.08)[np.abs(distance - 0.08) > 1e-5]
    )
    assert np.abs(np.abs(np.asarray(p.l)) - distance)[valid].max() < 1e-5
