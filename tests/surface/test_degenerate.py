"""Finding and repairing degenerate triangles."""

from __future__ import annotations

import numpy as np

from ndf_mi.surface.degenerate import degenerate_triangles, repair, triangle_quality


def square(count: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """A square of side 1 in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], axis=1)
    a = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + count, a + count + 1], 1), np.stack([a, a + count + 1, a + 1], 1)]
    )
    return vertices, faces.astype(np.int32)


def test_triangle_quality():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 1, 0], [2, 0, 0]])
    expected = [1, np.sqrt(3) / 2, 0]
    np.testing.assert_allclose(
        triangle_quality(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])), expected, atol=1e-12
    )


def test_repair_unfolds_what_is_folded_and_nothing_else():
    vertices, faces = square()
    offsets = np.zeros_like(vertices)
    offsets[:, 2] = 0.2 * vertices[:, 0]
    np.testing.assert_array_equal(repair(vertices, offsets, faces), offsets)
    offsets[40, :2] += [0.3, 0.1]
    assert degenerate_triangles(vertices, offsets, faces).any()
    repaired = repair(vertices, offsets, faces)
    assert not degenerate_triangles(vertices, repaired, faces).any()
    far = np.abs(vertices - vertices[40]).max(axis=1) > 0.45
    np.testing.assert_array_equal(repaired[far], offsets[far])


def test_repair_returns_to_known_offsets_and_no_further():
    """A slope that was there before a fold stays in the fold's place."""
    vertices, faces = square()
    known = np.zeros_like(vertices)
    known[:, 2] = 0.2 * vertices[:, 0]
    offsets = known + [0.0, 0.0, 0.01]
    offsets[40, :2] += [0.3, 0.1]
    repaired = repair(vertices, offsets, faces, known)
    assert not degenerate_triangles(vertices, repaired, faces).any()
    assert np.abs(repaired - known).max() < 0.011 and (repaired[40] == known[40]).all()
    # Where nothing can be kept, everything goes back.
    np.testing.assert_array_equal(repair(vertices, vertices * [-2.0, 0.0, 0.0], faces, known), known)
