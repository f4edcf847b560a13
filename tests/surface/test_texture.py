"""Seams and holes of the baseline's texture."""

from __future__ import annotations

import numpy as np

from ndf_mi.surface.texture import fill_unseen, split_seams


def test_seam_vertices_are_doubled():
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]], dtype=np.float32)
    uv_faces = np.array([[0, 1, 2], [4, 2, 3]])
    source, split, texels = split_seams(faces, uv, uv_faces)
    assert len(source) == 5
    np.testing.assert_array_equal(source[split], faces)
    np.testing.assert_array_equal(texels[split], uv[uv_faces])


def test_holes_take_the_neighbours_colour_and_seen_texels_stay():
    rng = np.random.default_rng(0)
    texture = rng.random((17, 30, 3)).astype(np.float32)
    texture[:, :15], texture[:, 15:] = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    seen = rng.random((17, 30)) < 0.4
    holed = np.where(seen[..., None], texture, 77).astype(np.float32)
    filled = fill_unseen(holed, seen)
    np.testing.assert_array_equal(filled[seen], texture[seen])
    np.testing.assert_allclose(filled[:, :10], texture[:, :10], atol=0.2)
    np.testing.assert_allclose(filled[:, 20:], texture[:, 20:], atol=0.2)
    assert filled.min() >= 0 and filled.max() <= 1


def test_one_seen_texel_colours_everything_and_none_changes_nothing():
    texture = np.arange(5 * 6 * 3, dtype=np.float32).reshape(5, 6, 3)
    seen = np.zeros((5, 6), dtype=bool)
    np.testing.assert_array_equal(fill_unseen(texture, seen), texture)
    seen[3, 4] = True
    np.testing.assert_allclose(fill_unseen(texture, seen), np.broadcast_to(texture[3, 4], texture.shape))
