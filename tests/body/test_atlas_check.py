"""The measures of an atlas on charts worked out by hand, overlaps against shapely, hidden places against
closed forms.
"""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import trimesh

from ndf_mi.body.atlas import Atlas, check_atlas
from ndf_mi.body.atlas_check import overlapping
from ndf_mi.body.atlas_seam import openness

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_stretched_square() -> None:
    """Twice as wide as high: σ = (√2, 1/√2) once the areas agree, so the energy is (2 + 1/2 + 1/2 + 2)/4."""
    report = check_atlas(SQUARE, FACES,
                         Atlas(np.array([[0, 0], [0.5, 0], [0.5, 0.25], [0, 0.25]], np.float32), FACES))
    assert report.valid and report.components == report.charts == 1
    assert report.covered == 0.125 and report.seam_length == 0
    assert report.energy == pytest.approx(1.25)
    assert report.area_stretch == pytest.approx((1, 1, 1)) and report.anisotropy == pytest.approx((2, 2))


def test_cut_square() -> None:
    """Cut along the diagonal; the second triangle at half the size: areas 4 : 1 in the plane, 1 : 1 on the
    surface.
    """
    uv = np.array([[0, 0], [0.5, 0], [0.5, 0.5], [0.75, 0.75], [1, 1], [0.75, 1]], np.float32)
    report = check_atlas(SQUARE, FACES, Atlas(uv, np.array([[0, 1, 2], [3, 4, 5]])))
    assert (report.components, report.charts, report.flipped, report.overlaps) == (1, 2, 0, 0)
    assert not report.valid
    assert report.seam_length == pytest.approx(np.sqrt(2))
    assert report.covered == pytest.approx(1 / 8 + 1 / 32)
    assert (report.area_stretch[0], report.area_stretch[2]) == pytest.approx((2 / 5, 8 / 5))


def test_flipped_and_folded() -> None:
    folded = np.array([[0, 0], [0.5, 0], [0.5, 0.5], [0.5, 0.25]], np.float32)
    report = check_atlas(SQUARE, FACES, Atlas(folded, FACES))
    assert (report.charts, report.flipped, report.overlaps) == (1, 1, 1) and not report.valid
    flat = np.array([[0, 0], [0.5, 0], [0.5, 0.5], [0.25, 0.25]], np.float32)
    report = check_atlas(SQUARE, FACES, Atlas(flat, FACES))
    assert (report.flipped, report.overlaps) == (1, 0)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ([[0.5, 0], [0.5, 0.5], [0, 0.5]], 0),  # across the whole edge
        ([[0.25, 0.25], [0.5, 0.25], [0.5, 0.5]], 0),  # a corner on the edge
        ([[0.125, 0.375], [0.5, 0.5], [0.375, 0.125]], 0),  # along part of the edge
        ([[0.25 - 2**-24, 0.25], [0.5, 0.25], [0.5, 0.5]], 1),  # in by the least step
        ([[0.125, 0.125], [0.25, 0.125], [0.125, 0.25]], 1),  # inside
        ([[0, 0], [0.5, 0], [0, 0.5]], 1),  # the same
        ([[-0.0, 0.5], [0.5, 0], [0, 0]], 1),  # the same, turned over
    ],
)
def test_overlap(other: list, expected: int) -> None:
    pair = np.array([[[0, 0], [0.5, 0], [0, 0.5]], other], float)
    assert len(overlapping(pair)) == len(overlapping(pair[::-1])) == expected


def test_overlaps_of_many_sizes() -> None:
    rng = np.random.default_rng(5)
    sizes = 0.5 ** rng.uniform(1, 9, (400, 1, 1))
    corners = rng.random((400, 1, 2)) * 0.4 + 0.3 + sizes * rng.uniform(-0.5, 0.5, (400, 3, 2))
    corners = np.round(corners * 2**24) / 2**24
    polygons = shapely.polygons(corners)
    expected = {
        (i, j) for i in range(400) for j in range(i + 1, 400)
        if shapely.relate_pattern(polygons[i], polygons[j], "T********")
    }
    assert len(expected) > 500
    assert {tuple(pair) for pair in overlapping(corners).tolist()} == expected


def test_openness() -> None:
    """The same all over a ball, at most half of all directions; nothing is seen of a ball inside it."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    seen = openness(ball.vertices, ball.faces)
    assert seen.min() > 0.2 and seen.max() < 0.5 and seen.std() < 0.03
    nested = trimesh.util.concatenate([ball, ball.copy().apply_scale(0.7)])
    seen = openness(nested.vertices, nested.faces)
    assert seen[: len(ball.vertices)].min() > 0.2 and seen[len(ball.vertices) :].max() == 0
