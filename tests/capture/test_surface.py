"""Mesh operations against trimesh and closed forms."""

from __future__ import annotations

import numpy as np
import trimesh

from ndf_mi.capture.synthesise.surface import averaging, clip, loop_subdivision, rim_distance


def square(side: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """The unit square in the plane z = 0 as a grid of triangles, facing +z."""
    x, y = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side))
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + side], 1), np.stack([a + 1, a + side + 1, a + side], 1)])
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), faces


def test_loop_subdivision_agrees_with_trimesh_on_closed_and_open_meshes() -> None:
    """Where Warren's vertex weights are Loop's: at valences 3 and 6, here of a tetrahedron's four-fold
    subdivision.
    """
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    solid = trimesh.Trimesh(corners, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]).subdivide().subdivide()
    turn = np.arange(6) * np.pi / 3
    ring = np.stack([np.cos(turn), np.sin(turn), 0.2 * np.sin(2 * turn + 0.3)], axis=1)
    fan = [[0, 1 + i, 1 + (i + 1) % 6] for i in range(6)]
    patch = trimesh.Trimesh(np.concatenate([[[0.1, 0, 0.4]], ring]), fan, process=False)
    for mesh in (solid, patch):
        matrix, faces = loop_subdivision(np.asarray(mesh.faces), len(mesh.vertices))
        vertices = matrix @ np.asarray(mesh.vertices)
        expected, expected_faces = trimesh.remesh.subdivide_loop(mesh.vertices, mesh.faces, iterations=1)
        assert len(faces) == len(expected_faces)
        centres, theirs = vertices[faces].mean(1), expected[expected_faces].mean(1)
        assert np.abs(centres[:, None] - theirs[None]).sum(-1).min(1).max() < 1e-9
        np.testing.assert_allclose(matrix.sum(axis=1), 1)


def test_clip_cuts_along_the_zero_and_keeps_the_side_that_faces_up() -> None:
    vertices, faces = square()
    matrix, kept = clip(faces, 0.37 - vertices[:, 0] - 0.2 * vertices[:, 1])
    cut = trimesh.Trimesh(matrix @ vertices, kept, process=False)
    assert abs(cut.area - (0.37 + 0.17) / 2) < 1e-12
    assert (cut.face_normals[:, 2] > 0.999).all()
    values = 0.37 - cut.vertices[:, 0] - 0.2 * cut.vertices[:, 1]
    assert values.min() > -1e-12
    np.testing.assert_allclose(matrix.sum(axis=1), 1)


def test_rim_distance_is_that_to_the_nearest_side_of_a_square() -> None:
    vertices, faces = square()
    x, y = vertices[:, 0], vertices[:, 1]
    np.testing.assert_allclose(rim_distance(vertices, faces), np.minimum.reduce([x, 1 - x, y, 1 - y]),
                               atol=1e-12)
    ball = trimesh.creation.icosphere(1)
    assert np.isinf(rim_distance(ball.vertices, ball.faces)).all()


def test_averaging_leaves_linear_fields_alone_inside_a_regular_grid() -> None:
    vertices, faces = square()
    inner = rim_distance(vertices, faces) > 0
    moved = averaging(faces, len(vertices)) @ vertices
    np.testing.assert_allclose(moved[inner], vertices[inner], atol=1e-12)
    lone = averaging(faces, len(vertices) + 1)
    np.testing.assert_allclose(np.asarray(lone.sum(axis=1)).ravel(), 1)
