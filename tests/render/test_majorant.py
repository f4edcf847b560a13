"""Estimates of the density and nested shells around them, against a density known in closed form."""

import itertools

import igl
import mitsuba as mi
import numpy as np
import pytest
import trimesh
from ridge_field import make_ridge

from ndf_mi.render import majorant, nested
from ndf_mi.render.majorant import FLOOR, MARGIN, Bounds, bounds, densities, exceeding, random_points
from ndf_mi.render.nested import Majorants, choose_levels, corner_ranks, cut_layers, layer_majorants, ranks
from ndf_mi.render.shell import Grid, distances, spread

RADIUS = 0.3
CELL = 0.02


def flat(run, row=0):
    return mi.Float(run.poses.vertices[row].ravel())


def exact(run, density, points):
    """σ at points by libigl's signed distance to the ball's mesh."""
    vertices, faces = run.poses.vertices[0].astype(np.float64), run.body.faces.astype(np.int64)
    l = igl.signed_distance(points.astype(np.float64), vertices, faces,
                            igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[0]
    return density(l)


@pytest.fixture
def ridge(make_run):
    return make_ridge(make_run)


def test_densities_are_the_fields(ridge):
    run, density = ridge
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.45, 0.45, (3000, 3))
    found = densities(run.posed(0), points)
    assert found == pytest.approx(exact(run, density, points), rel=2e-3, abs=2e-2)
    assert found.max() > 20


def test_estimates_are_above_the_density(ridge):
    run, density = ridge
    preset = run.model.field.preset
    estimate = bounds(run.posed(0), preset, distances(run.model.surface, flat(run), preset.band, CELL))
    points = random_points(estimate.grid, np.ones(estimate.grid.shape, bool), 20000, 1)
    sigma = exact(run, density, points)
    cells = estimate.grid.index(points)
    assert (sigma[~estimate.band[cells]] == 0).all()
    assert (sigma <= estimate.upper[cells]).all()
    assert estimate.limit == pytest.approx(1.05 * preset.density_limit)
    assert estimate.upper.max() <= estimate.limit
    assert estimate.upper[estimate.band].min() >= FLOOR
    # Not much above either: no more than the margin times the largest density within two parts of the cell.
    assert estimate.upper.max() <= MARGIN * density(np.linspace(-0.03, 0.08, 1000)).max() * 1.001


def test_a_margin_beyond_the_limit_is_cut_to_it(ridge):
    run, _ = ridge
    preset = run.model.field.preset
    estimate = bounds(run.posed(0), preset, distances(run.model.surface, flat(run), preset.band, 0.03),
                      margin=1e6)
    assert estimate.upper.max() == np.float32(estimate.limit)


def test_transmittance_to_each_cell_is_the_mean_of_six_beams():
    rng = np.random.default_rng(4)
    sigma = rng.uniform(0, 9, (5, 4, 6)).astype(np.float32)
    cell, (i, j, k) = 0.1, (2, 1, 3)
    beams = [sigma[:i, j, k], sigma[i + 1 :, j, k], sigma[i, :j, k], sigma[i, j + 1 :, k], sigma[i, j, :k],
             sigma[i, j, k + 1 :]]
    expected = np.mean([np.exp(-cell * (b.astype(np.float64).sum() + 0.5 * sigma[i, j, k])) for b in beams])
    assert majorant.transmittances(sigma, cell)[i, j, k] == pytest.approx(expected, rel=1e-5)


def blob(shape=(22, 20, 24), seed=3):
    """Estimates of no field: bumps of densities over four decades."""
    rng = np.random.default_rng(seed)
    at = np.indices(shape).astype(float)
    upper = sum(10 ** rng.uniform(-1, 2.6)
                * np.exp(-((at - (np.array(shape)
                                  * rng.uniform(0.3, 0.7, 3))[:, None, None, None]) ** 2).sum(0)
                                                    / rng.uniform(2, 30)) for _ in range(6))
    band = upper > 0.02
    band[[0, -1]] = band[:, [0, -1]] = band[:, :, [0, -1]] = False
    upper = np.where(band, np.maximum(upper, FLOOR), 0).astype(np.float32)
    return Bounds(Grid(np.zeros(3), 0.02, shape), band, upper, np.ones(shape, np.float32), float(upper.max()))


@pytest.mark.parametrize("count", [2, 3])
def test_levels_are_the_best_of_all(count):
    """Dynamic programming against all choices, by the cost that it is said to minimise."""
    estimate = blob()
    upper = estimate.upper[estimate.band]
    levels = np.geomspace(upper.min(), upper.max(), nested.CANDIDATES + 1)[:-1]
    cell = estimate.grid.cell

    def measures(level):
        own = estimate.band & (estimate.upper > level)
        rim = int(spread(own).sum() - own.sum())
        return (own.sum() + 0.4 * rim) * cell**3, rim * cell**2

    volume, area = np.array([measures(level) for level in levels]).T

    def cost(chosen):
        v = [estimate.band.sum() * cell**3, *volume[list(chosen)], 0]
        m = [*levels[list(chosen)], upper.max()]
        return sum(m[k] * (v[k] - v[k + 1]) for k in range(len(m))) + 0.5 * sum(area[j] / 2 for j in chosen)

    best = min(cost(c) for c in itertools.combinations(range(1, nested.CANDIDATES), count - 1))
    found = choose_levels(estimate, 4)[count - 1]
    assert list(found) == sorted(found)
    index = [int(np.argmin(np.abs(levels - t))) for t in found]
    assert cost(index) == pytest.approx(best, rel=1e-5)


def test_constant_density_gets_one_shell():
    estimate = blob()
    same = Bounds(estimate.grid, estimate.band, np.where(estimate.band, 5, 0).astype(np.float32),
                  estimate.seen, 10.0)
    assert choose_levels(same, 4) == [()]


def test_ranks_differ_by_one_at_most_and_hold_the_dense_cells():
    estimate = blob()
    levels = (0.5, 5.0, 50.0)
    grid, rank = ranks(estimate, levels)
    lowest, highest = corner_ranks(rank)
    assert (highest - lowest).max() == 1
    assert rank[0].max() == rank[:, 0].max() == rank[:, :, 0].max() == rank[-1].max() == 0
    pad = len(levels) + 1
    inner = (slice(pad, -pad),) * 3
    wanted = np.where(estimate.band, 1 + np.searchsorted(levels, estimate.upper), 0)
    assert (lowest[inner] >= wanted).all()
    majorants = layer_majorants(grid, rank, estimate)
    for k, value in enumerate(majorants):
        here = ((lowest <= k + 1) & (highest >= k + 1))[inner]
        assert value == max(estimate.upper[here].max(), np.float32(FLOOR))
    assert majorants[:3] == sorted(majorants[:3]) and all(
        m <= t for m, t in zip(majorants, levels, strict=False))
    one = ranks(estimate, ())[1]
    alone = layer_majorants(grid, (rank > 0) * np.uint8(1), estimate)
    cost, cost_of_one = (nested.expected_cost(*shells, estimate, 0.0)
                         for shells in ((rank, majorants), (one, alone)))
    assert cost < cost_of_one


def test_shells_are_closed_and_strictly_one_within_the_other(ridge):
    run, density = ridge
    preset = run.model.field.preset
    sampled = distances(run.model.surface, flat(run), preset.band, CELL)
    estimate = bounds(run.posed(0), preset, sampled)
    layers = cut_layers(estimate, sampled, preset.band, preset.band_inside, (2.0, 20.0, 60.0))
    majorants = layer_majorants(layers.grid, layers.rank, estimate)
    assert len(layers.shells) == len(majorants) == 4 and majorants == sorted(majorants)
    for vertices, faces in layers.shells:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    for (v0, f0), (v1, f1) in itertools.pairwise((v.astype(np.float64), f.astype(np.int64)) for v,
                                                 f in layers.shells):
        assert (np.asarray(igl.winding_number(v0, f0, v1)) > 0.5).all()
        for points, vertices, faces in ((v1, v0, f0), (v0, v1, f1), (v1[f1].mean(1), v0, f0),
                                        (v0[f0].mean(1), v1, f1)):
            gap = np.sqrt(igl.point_mesh_squared_distance(points, vertices, faces)[0])
            # Far above what Mitsuba moves rays by when it spawns them, 2.7e-4 m at two metres.
            assert gap.min() > 0.1 * CELL

    # Every point of the band is in some layer, and its density below that layer's majorant, by the meshes
    # alone.
    rng = np.random.default_rng(8)
    points = rng.uniform(-0.4, 0.4, (30000, 3))
    layer = sum((np.asarray(igl.winding_number(v.astype(np.float64), f.astype(np.int64),
                                               points)) > 0.5).astype(int)
                for v, f in layers.shells) - 1
    sigma = exact(run, density, points)
    assert (sigma[layer < 0] == 0).all()
    assert (sigma <= np.array([0, *majorants])[layer + 1]).all()
    assert (layers.locate(points) <= layer).all()


def test_shells_of_a_field_with_contrast(ridge):
    run, density = ridge
    shells = Majorants(run.model, run.posed(0), flat(run), 4, CELL)
    assert 2 <= len(shells.layers.shells) == len(shells.values) <= 4
    assert shells.values == sorted(shells.values) and shells.values[0] < 0.1 * shells.values[-1]
    assert shells.excess is None and shells.left_out(flat(run)) == 0


def test_a_spike_between_the_samples_is_found_and_majorants_are_raised(make_run):
    run, density = make_ridge(make_run, peak=2.0, slope=3000.0, low=0.03, high=0.0302)
    shells = Majorants(run.model, run.posed(0), flat(run), 3, 0.06)
    assert shells.excess is not None
    assert shells.excess.density > shells.excess.majorant
    assert max(shells.values) >= shells.excess.density
    distance = abs(np.linalg.norm(shells.excess.point) - RADIUS - 0.03)
    assert distance < 0.004 and "per metre" in str(shells.excess)


def test_excess_names_the_worst_point():
    points = np.arange(12.0).reshape(4, 3)
    found = exceeding(points, np.array([1.0, 5.0, 3.0, 1.0]), np.array([2.0, 4.0, 2.0, 2.0]))
    assert (found.checked, found.count, found.density, found.majorant) == (4, 2, 3.0, 2.0)
    assert (found.point == points[2]).all()
    assert exceeding(points, np.ones(4), np.full(4, 2.0)) is None


def test_majorants_follow_the_field_and_the_body(ridge, make_run):
    run, thin = ridge
    shells = Majorants(run.model, run.posed(0), flat(run), 3, CELL)
    before = list(shells.values)
    denser, density = make_ridge(make_run, "denser", peak=2.0)
    shells.update(denser.posed(0))
    assert all(b > a for a, b in zip(before, shells.values, strict=True))
    points = random_points(shells.layers.grid, np.ones(shells.layers.grid.shape, bool), 20000, 5)
    layer = shells.layers.locate(points)
    sigma = exact(denser, density, points)
    assert (sigma[layer < 0] == 0).all() and (sigma <= np.array([0, *shells.values])[layer + 1]).all()
    # Five centimetres aside: part of the band is outside the shells now; within them majorants hold.
    moved = flat(run, 1)
    assert shells.left_out(moved) > 0.05
    shells.update(run.posed(1), moved)
    points = points[layer >= 0]
    sigma = exact(run, thin, points - [0.05, 0, 0])
    assert sigma.max() > 20 and (sigma <= np.array(shells.values)[layer[layer >= 0]]).all()
