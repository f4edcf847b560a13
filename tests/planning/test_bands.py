"""Widths of the band from where masks and bodies disagree."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ndf_mi.field import preset
from ndf_mi.planning.bands import LEAST, RADIUS, SLOPE, place_bands, spread_out, widths
from ndf_mi.planning.standoff import Disagreement, Standoff

BALL = trimesh.creation.icosphere(4, 0.3)
FACES, REST = np.asarray(BALL.faces), np.asarray(BALL.vertices)
FULL = preset("fast")
#: What blur and the density's depth need where everything agrees, in metres.
FLOOR = np.maximum(widths(np.zeros(1), np.zeros(1), 0.003, FULL)[0], LEAST)
NONE = Disagreement(np.zeros(0), np.zeros(0), np.zeros(0, int))


def one_spot(distance: float, cost: float = 0.1, count: int = 500) -> tuple[Disagreement, np.ndarray]:
    """Pixels that all show something that far off around the pole at +x, and the vertices' distances from
    it along the ball."""
    around = np.flatnonzero(BALL.triangles_center[:, 0] > 0.295)
    triangle = np.random.default_rng(0).choice(around, count)
    away = 0.3 * np.arccos(np.clip(REST[:, 0] / 0.3, -1, 1))
    return Disagreement(np.full(count, distance), np.full(count, cost), triangle), away


def test_the_band_is_wide_where_masks_disagree_and_narrow_elsewhere() -> None:
    spot, away = one_spot(0.15)
    found = place_bands(REST, FACES, Standoff(spot, NONE, 20_000), 1e-5, 0.003, FULL)
    top = (0.15 + 0.003) / 0.8
    assert found.shape == (len(REST), 2) and found.dtype == np.float32
    assert found[:, 0].max() == pytest.approx(top, abs=0.003)
    assert (found[away < RADIUS - 0.02, 0] > top - 0.003).all()
    # Down to the least width with the slope, and the pole at -x is 94 cm away.
    assert found[REST[:, 0] < -0.29, 0].max() == pytest.approx(FLOOR[0], abs=1e-6)
    edges = BALL.edges_unique
    steps = np.abs(np.diff(found[edges], axis=1)[:, 0]).astype(np.float64)
    assert (steps <= 1.001 * SLOPE * BALL.edges_unique_length[:, None]).all()
    np.testing.assert_allclose(found[:, 1], FLOOR[1], rtol=1e-6)


def test_what_costs_little_widens_nothing() -> None:
    spot, _ = one_spot(0.15, cost=1e-6)
    found = place_bands(REST, FACES, Standoff(spot, NONE, 20_000), 1e-3, 0.003, FULL)
    assert found[:, 0].max() == pytest.approx(FLOOR[0], abs=1e-6)


def test_bodies_beyond_the_masks_deepen_the_band_and_residuals_widen_both() -> None:
    spot, away = one_spot(0.04)
    found = place_bands(REST, FACES, Standoff(NONE, spot, 20_000), 1e-5, 0.003, FULL)
    assert (found[away < 0.02, 1] > 0.043).all() and (found[:, 0] >= found[:, 1] / 0.8 - 1e-6).all()
    more = place_bands(REST, FACES, Standoff(NONE, NONE, 20_000), 1e-5, 0.003, FULL,
                       np.full(len(REST), 0.05))
    assert more.min() > 0.05
    assert (widths(np.zeros(1), np.full(1, 0.3), 0.003, FULL) <= FULL.band / 0.8).all()
    assert more.max() < 0.09


def test_spreading_is_the_envelope_of_cones() -> None:
    """On a flat strip of equal steps, where the way along edges is the distance."""
    x = np.arange(40) * 0.01
    strip = np.concatenate([np.stack([x, 0 * x, 0 * x], 1), np.stack([x, 0 * x + 1, 0 * x], 1)])
    i = np.arange(39)
    faces = np.concatenate([np.stack([i, i + 1, i + 40], 1), np.stack([i + 1, i + 41, i + 40], 1)])
    width = np.full(80, 0.02)
    width[[5, 30]] = 0.1, 0.06
    expected = np.maximum.reduce([np.full(40, 0.02), 0.1 - 0.5 * np.abs(x - x[5]),
                                  0.06 - 0.5 * np.abs(x - x[30])])
    np.testing.assert_allclose(spread_out(strip, faces, width)[:40], expected, atol=1e-9)
