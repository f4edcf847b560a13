from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ndf_mi.projection.topology import build_tree, pair_triangles


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.icosphere(subdivisions=2), trimesh.creation.box(), trimesh.creation.cylinder(1, 2)]
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
