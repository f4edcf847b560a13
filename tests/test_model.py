"""Projection, deformation and field composed: gradients reach vertices and weights, with and without symbolic
evaluation."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi import variants
from ndf_mi.errors import InputError
from ndf_mi.model import PosedModel, networks_here
from ndf_mi.projection import PosedSurface
from ndf_mi.render.quadrature import quadrature


@pytest.fixture
def run(make_run):
    run = make_run(seed=3, density_bias=1.0, density_gain=10.0, grid_finest=16)
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
        surface = PosedSurface(run.model.surface, flat, run.model.band)
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
