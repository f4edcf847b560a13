"""The quadrature against closed forms: a box and a ball of constant density, a linear ramp; and against
float64 sums."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.render.quadrature import quadrature
from ndf_mi.render.sampling import QUANTUM, box_interval, compact, stratified


@dataclass
class Ball:
    """Density `sigma` inside a ball of radius 1 around the origin, coloured by position."""

    sigma: mi.Float
    sample_factor: int = 1

    def __post_init__(self):
        self.bbox = mi.BoundingBox3f(mi.Point3f(-1), mi.Point3f(1))

    def may_contain(self, x):
        return dr.all(dr.abs(x) < 1)

    def locate(self, x, active):
        return Located.anywhere(active & (dr.norm(x) < 1))

    def evaluate(self, x, d, located, active):
        sigma = self.sigma + dr.zeros(mi.Float, dr.width(x))
        return FieldSample(sigma, mi.Color3f(0.25, 0.5, 0.75), mi.Point3f(x), mi.Normal3f(0, 0, 1))


def rays(n, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1.2, 1.2, (2, n)).astype(np.float32)
    o = np.stack([x, y, np.full(n, -4, np.float32)])
    return mi.Ray3f(mi.Point3f(o), mi.Vector3f(0, 0, 1)), x.astype(np.float64), y.astype(np.float64)


@pytest.mark.parametrize("sigma", [1e-6, 1e-2, 1.0, 30.0, 1e4])
def test_ball_of_constant_density_has_its_closed_form(sigma):
    ray, x, y = rays(500)
    seen = quadrature(Ball(mi.Float(sigma)), ray, 4000)
    chord = 2 * np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    step = 2 / 4000
    # The chord is known to within a step at each end.
    low, high = (-np.expm1(-sigma * np.maximum(chord + k * 2 * step, 0)) for k in (-1, 1))
    opacity = seen.opacity.numpy()
    assert (opacity >= low * (1 - 1e-4)).all() and (opacity <= high * (1 + 1e-4)).all()
    for channel, value in zip(seen.colour, (0.25, 0.5, 0.75), strict=True):
        np.testing.assert_allclose(channel.numpy(), value * opacity, rtol=1e-4, atol=1e-7)


def test_depth_of_an_opaque_ball_is_its_front():
    ray, x, y = rays(500)
    seen = quadrature(Ball(mi.Float(1e5)), ray, 4000, geometry=True)
    inside = x**2 + y**2 < 0.98
    front = 4 - np.sqrt(1 - (x**2 + y**2)[inside])
    np.testing.assert_allclose(seen.depth.numpy()[inside], front, atol=1e-3)
    np.testing.assert_allclose(seen.u.z.numpy()[inside], front - 4, atol=1e-3)
    assert (seen.opacity.numpy()[x**2 + y**2 > 1.001] == 0).all()
    assert (seen.depth.numpy()[x**2 + y**2 > 1.001] == 0).all()


def test_gradient_of_transmittance():
    # d/dσ (1 − exp(−σ·chord)) = chord·exp(−σ·chord)
    ray, x, y = rays(500)
    sigma = mi.Float(0.7)
    dr.enable_grad(sigma)
    seen = quadrature(Ball(sigma), ray, 2000)
    dr.backward(dr.sum(seen.opacity))
    chord = 2 * np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    assert float(dr.grad(sigma)[0]) == pytest.approx((chord * np.exp(-0.7 * chord)).sum(), rel=2e-3)


def test_all_rays_missing_gives_nothing_and_nothing_infinite():
    ray = mi.Ray3f(mi.Point3f(0, 5, -4) + dr.zeros(mi.Point3f, 7), mi.Vector3f(0, 0, 1))
    seen = quadrature(Ball(mi.Float(3.0)), ray, 16, geometry=True)
    for value in (*seen.colour, seen.opacity, seen.depth, *seen.u, *seen.normal):
        assert (value.numpy() == 0).all()
    assert seen.evaluated == 0


def test_jitter_does_not_change_the_mean():
    ray, *_ = rays(2000)
    plain = quadrature(Ball(mi.Float(2.0)), ray, 64)
    rng = np.random.default_rng(1)
    jittered = quadrature(Ball(mi.Float(2.0)), ray, 64,
                          jitter=mi.Float(rng.random(2000 * 64, dtype=np.float32)))
    assert float(dr.mean(jittered.opacity)[0]) == pytest.approx(float(dr.mean(plain.opacity)[0]), rel=5e-3)


def test_strata_end_at_far_and_are_finite():
    near, far = mi.Float(1, 2, 0), mi.Float(3, 2.5, 0)
    t, width = stratified(near, far, 4, None)
    np.testing.assert_allclose(t.numpy().reshape(3, 4)[0], [1.25, 1.75, 2.25, 2.75])
    np.testing.assert_allclose(width.numpy().reshape(3, 4)[:, 0], [0.5, 0.125, 0])


def test_box_interval_of_a_ray_that_starts_inside_and_of_one_behind():
    box = mi.BoundingBox3f(mi.Point3f(0, 0, 0), mi.Point3f(1, 1, 1))
    ray = mi.Ray3f(mi.Point3f([0.5, 0.5], [0.5, 0.5], [0.25, 2.0]), mi.Vector3f(0, 0, 1))
    hit, near, far = box_interval(box, ray)
    assert list(hit.numpy()) == [True, False]
    np.testing.assert_allclose(near.numpy(), [0, 0])
    np.testing.assert_allclose(far.numpy(), [0.75, 0])


@pytest.mark.parametrize("every", [3, 30, 100_000])
def test_compaction_chooses_lanes_in_order_and_pads_by_half_at_most(every):
    index, real, count = compact(dr.arange(mi.UInt32, 30_000) % every == every - 1)
    expected = np.arange(30_000)[every - 1 :: every]
    assert count == len(expected) == int(real.numpy().sum())
    np.testing.assert_array_equal(index.numpy()[:count], expected)
    assert count <= len(index) == len(real) <= max(1.5 * count, QUANTUM)
