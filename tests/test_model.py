"""Projection, deformation and field composed: gradients reach vertices and weights, with and without symbolic
evaluation."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import RADIUS, uneven

from ndf_mi import variants
from ndf_mi.errors import InputError
from ndf_mi.model import PosedModel, networks_here
from ndf_mi.render.quadrature import quadrature


@pytest.fixture(params=[False, True], ids=["one width", "uneven"])
def run(make_run, request):
    run = make_run(seed=3, density_bias=1.0, density_gain=10.0, grid_finest=16,
                   bands=uneven() if request.param else None)
    run.parameters = run.parameters.replace(grid=run.parameters.grid * 5e3)
    return run


def rays(n=4000):
    rng = np.random.default_rng(0)
    o = np.stack([*rng.uniform(-0.45, 0.45, (2, n)), np.full(n, 2.0)]).astype(np.float32)
    # Uneven over the image, so that moving and scaling the body changes the sum.
    return mi.Ray3f(mi.Point3f(o), mi.Vector3f(0, 0, -1)), 1 + o[0].astype(np.float64) + 0.5 * o[1]


@pytest.mark.parametrize("trial", range(4))
def test_gradients_reach_the_vertices(run, trial):
    """Of the quadrature along random affine motions of the body, against central differences."""
    ray, weights = rays()
    start = run.poses.vertices[0].astype(np.float64)
    rng = np.random.default_rng(trial)
    direction = start @ rng.normal(size=(3, 3)) + 0.2 * rng.normal(size=3)

    def render(vertices):
        flat = mi.Float(vertices.astype(np.float32).ravel())
        dr.enable_grad(flat)
        surface = run.model.pose(flat)
        seen = quadrature(PosedModel(run.model, run.parameters, surface, run.pose_vector(0)), ray, 1024)
        return seen.colour.x + seen.colour.y + 0.3 * seen.opacity, flat

    image, flat = render(start)
    dr.backward(dr.sum(image * mi.Float(weights.astype(np.float32))))
    gradient = dr.grad(flat).numpy().astype(np.float64)
    slope = float(gradient @ direction.ravel())
    h = 4e-4
    ahead, behind = ((render(start + sign * h * direction)[0].numpy() * weights).sum() for sign in (1, -1))
    assert slope == pytest.approx((ahead - behind) / (2 * h), rel=1e-2)


@pytest.mark.parametrize("widths", [(16,), (96,)])
def test_samples_behind_opaque_parts_are_skipped_without_being_missed(make_run, widths):
    """Image and gradients stay within the transmittance asked for, and fewer samples reach the networks."""
    run = make_run(seed=3, density_bias=1.0, density_gain=60.0, grid_finest=16, density_layers=widths)
    run.parameters = run.parameters.replace(grid=run.parameters.grid * 5e3)
    ray, weights = rays(2000)
    found = []
    for min_transmittance in (0.0, 1e-3):
        weights_now = mi.Float(run.parameters.weights)
        dr.enable_grad(weights_now)
        posed = run.posed(0, parameters=run.parameters.replace(weights=weights_now))
        seen = quadrature(posed, ray, 256, min_transmittance=min_transmittance)
        dr.backward(dr.sum((seen.colour.x + 0.3 * seen.opacity) * mi.Float(weights.astype(np.float32))))
        found.append((seen, dr.grad(weights_now).numpy()))
    (whole, slope), (part, other) = found
    np.testing.assert_allclose(part.colour.numpy(), whole.colour.numpy(), atol=1e-3)
    np.testing.assert_allclose(part.opacity.numpy(), whole.opacity.numpy(), atol=1e-3)
    assert part.evaluated < 0.7 * whole.evaluated
    assert np.linalg.norm(other - slope) < 0.01 * np.linalg.norm(slope)


def test_symbolic_and_batched_evaluation_agree(run):
    rng = np.random.default_rng(1)
    x = mi.Point3f(rng.uniform(-0.4, 0.4, (3, 20_000)).astype(np.float32))
    d = dr.normalize(mi.Vector3f(rng.normal(size=(3, 20_000)).astype(np.float32)))
    posed = run.posed(0)
    posed.bound.pack()
    fused = posed.fused(x, d)
    located = posed.locate(x, mi.Bool(True))
    batched = posed.evaluate(x, d, located, located.valid)
    half = posed.bound.half
    np.testing.assert_allclose(fused.sigma.numpy(), batched.sigma.numpy(), rtol=1e-2 if half else 1e-7,
                               atol=1e-4)
    inside = located.valid.numpy()
    assert 0.1 < inside.mean() < 0.9 and (fused.sigma.numpy()[~inside] == 0).all()
    np.testing.assert_allclose(fused.colour.numpy()[:, inside], batched.colour.numpy()[:, inside],
                               atol=2e-3 if half else 1e-5)


def test_networks_run_in_every_form_to_the_same_values(run):
    """In half precision up to its 11 bits, which sums of some tens of products carry on."""
    rng = np.random.default_rng(1)
    x = mi.Point3f(rng.uniform(-0.35, 0.35, (3, 5_000)).astype(np.float32))
    d = dr.normalize(mi.Vector3f(rng.normal(size=(3, 5_000)).astype(np.float32)))
    found = {}
    for networks in networks_here():
        posed = run.posed(0, networks)
        located = posed.locate(x, mi.Bool(True))
        sample = posed.evaluate(x, d, located, located.valid)
        assert posed.bound.packed == (networks != "batched"
                                      and (networks != "auto" or variants.fused_width() > 0))
        found[networks] = np.stack([sample.sigma.numpy() / 10,
                                    *sample.colour.numpy()])[:, located.valid.numpy()]
    for networks in {"auto", "fused"} & set(found):
        np.testing.assert_allclose(found[networks], found["batched"], atol=1e-4)
    error = np.abs(found["half"] - found["batched"])
    assert 1e-5 < error.max() < 0.03 and error.mean() < 3e-3
    with pytest.raises(InputError, match="networks"):
        run.posed(0, "quick")


def test_lanes_without_a_meaning_do_not_poison_gradients(run):
    x = np.random.default_rng(1).uniform(-0.4, 0.4, (3, 2000)).astype(np.float32)
    x[:, ::7] = np.nan
    active = np.ones(2000, bool)
    active[::7] = False
    for symbolic in (True, False):
        weights = mi.Float(run.parameters.weights)
        dr.enable_grad(weights)
        posed = run.posed(0, parameters=run.parameters.replace(weights=weights))
        posed.bound.pack()
        d = mi.Vector3f(0, 0, mi.Float(np.where(active, 1, np.nan).astype(np.float32)))
        if symbolic:
            sample = posed.fused(mi.Point3f(x), d, mi.Bool(active))
        else:
            located = posed.locate(mi.Point3f(x), mi.Bool(active))
            sample = posed.evaluate(mi.Point3f(x), d, located, located.valid)
        dr.backward(dr.sum(dr.select(mi.Bool(active), sample.sigma + sample.colour.x, 0)))
        gradient = dr.grad(weights).numpy()
        assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0


def test_the_density_ends_where_the_band_of_its_place_does(make_constant_run):
    """Along rays from the ball's centre: constant within the band, a smooth fall over the local widths."""
    rng = np.random.default_rng(2)
    d = rng.normal(size=(3, 4000))
    d /= np.linalg.norm(d, axis=0)
    l = rng.uniform(-0.1, 0.1, 4000)
    x = mi.Point3f((d * (RADIUS + l)).astype(np.float32))
    outside = 0.08 * (0.25 + 0.75 * (d[0] + 1) / 2)
    depth = np.minimum((outside - l) / outside, (0.5 * outside + l) / (0.5 * outside))
    for fade in (0.0, 0.4):
        run = make_constant_run(2.0, bands=uneven(0.08, 0.04), band_inside=0.04, band_fade=fade)
        posed = run.posed(0)
        posed.bound.pack()
        sigma = posed.fused(x, mi.Vector3f(0, 0, 1)).sigma.numpy()
        s = np.clip(depth / fade, 0, 1) if fade else (depth > 0).astype(float)
        # The ball is made of triangles, up to 2 mm inside of the sphere.
        clear = (np.abs(depth) > 0.1) if not fade else np.full(4000, True)
        np.testing.assert_allclose(sigma[clear], (2 * s * s * (3 - 2 * s))[clear], atol=0.7 if fade else 2e-2)
        assert np.abs(sigma - 2 * s * s * (3 - 2 * s)).mean() < 0.05


def test_a_constant_width_renders_as_a_band_of_one_width(make_run):
    ray, _ = rays(2000)
    seen = []
    for bands in (None, np.full((642, 2), [0.08, 0.03], np.float32)):
        run = make_run(seed=3, density_bias=1.0, density_gain=10.0, bands=bands)
        seen.append(quadrature(run.posed(0), ray, 64))
    np.testing.assert_allclose(seen[0].colour.numpy(), seen[1].colour.numpy(), atol=1e-6)
    assert seen[0].evaluated == seen[1].evaluated


def test_bands_wider_than_the_preset_are_refused(make_run):
    with pytest.raises(InputError, match=r"a width of 0\.09 m.*`band`"):
        make_run(bands=uneven(0.09))
    with pytest.raises(InputError, match=r"`band_inside`"):
        make_run(bands=uneven(inside=0.04))
