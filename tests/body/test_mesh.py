"""Geometry of triangle meshes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ndf_mi.body.mesh import opposite_half_edges, vertex_normals


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_normals_of_a_ball_point_away_from_its_centre(scale: float) -> None:
    ball = trimesh.creation.icosphere(3)
    normals = vertex_normals(scale * np.asarray(ball.vertices), np.asarray(ball.faces))
    assert np.sum(normals * ball.vertices, axis=1).min() > 0.999
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


def test_triangles_count_by_their_areas() -> None:
    """A corner of a box with sides 1, 2 and 3: its three faces' areas are 6, 3 and 2, of which triangles take
    halves.
    """
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=np.float64)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2]])
    expected = -np.array([6, 3, 2]) / np.linalg.norm([6, 3, 2])
    np.testing.assert_allclose(vertex_normals(vertices, faces)[0], expected)


def test_normals_that_cancel_out_or_that_no_triangle_gives_are_zero() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]], dtype=np.float64)
    both_sides = np.array([[0, 1, 2], [0, 2, 1]])
    assert not vertex_normals(vertices, both_sides).any()


def test_opposite_half_edges_of_two_triangles() -> None:
    np.testing.assert_array_equal(
        opposite_half_edges(np.array([[0, 1, 2], [2, 1, 3]])), [-1, 3, -1, 1, -1, -1]
    )


def test_an_edge_of_three_triangles_has_no_opposite_half_edges() -> None:
    assert (opposite_half_edges(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])) == -1).all()
