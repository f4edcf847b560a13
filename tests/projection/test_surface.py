from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from ndf_mi.errors import InputError
from ndf_mi.projection import PosedSurface, Surface
from ndf_mi.projection.surface import build_tree, pair_triangles

V = np.eye(4, 3)
F = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.zeros((3, 2))
G = np.array([[0, 1, 2], [0, 1, 2]])


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        ((F, None, None, V), "uv"),
        ((F, UV, G, V[:3]), "faces"),
        ((F - 1, UV, G, V), "faces"),
        ((F.astype(float), UV, G, V), "faces"),
        ((F[:0], UV, G[:0], V), "faces"),
        ((F, UV[:, :1], G, V), "uv"),
        ((F, UV, G[:1], V), "uv_faces"),
        ((F, UV[:2], G, V), "uv_faces"),
        ((F, UV * np.nan, G, V), "uv"),
        ((F, UV, G, np.full((4, 3), np.inf)), "reference_vertices"),
    ],
)
def test_what_is_wrong_is_named(arguments: tuple, where: str) -> None:
    with pytest.raises(InputError) as caught:
        Surface(*arguments)
    assert caught.value.where == where


@pytest.mark.parametrize(
    ("vertices", "band", "where"),
    [
        (V[:3].ravel(), 0.1, "vertices"),
        (np.full(12, np.nan), 0.1, "vertices"),
        (V.ravel(), 0.0, "band"),
        (V.ravel(), float("nan"), "band"),
    ],
)
def test_a_wrong_pose_is_named(vertices: np.ndarray, band: float, where: str) -> None:
    with pytest.raises(InputError) as caught:
        PosedSurface(Surface(F, UV, G, V), mi.Float(vertices.astype(np.float32)), band)
    assert caught.value.where == where


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.icosphere(subdivisions=2), trimesh.creation.box(),
             trimesh.creation.cylinder(1, 2)]
)
def test_pairs_hold_each_triangle_once(mesh: trimesh.Trimesh) -> None:
    corners, triangles = pair_triangles(mesh.vertices, np.asarray(mesh.faces))
    twice = triangles[:, 0] == triangles[:, 1]
    held = np.concatenate([triangles[:, 0], triangles[~twice, 1]])
    np.testing.assert_array_equal(np.sort(held), np.arange(len(mesh.faces)))
    for (a, b, c, d), (t, n) in zip(corners, triangles, strict=True):
        assert {a, b, c} == set(mesh.faces[t])
        assert {a, c, d} == (set(mesh.faces[n]) if t != n else {a, c})


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 13])
def test_tree_is_complete_and_holds_each_pair_once(count: int) -> None:
    rng = np.random.default_rng(count)
    tree = build_tree(rng.normal(size=(3 * count, 3)), np.arange(3 * count).reshape(-1, 3))
    assert tree.depth >= 1 and 2**tree.depth == len(tree.corners) == len(tree.triangles) < 4 * max(count, 1)
    np.testing.assert_array_equal(np.sort(tree.triangles[tree.occupied, 0]), np.arange(count))
    assert tree.triangles.max() < count
