"""Segments through several fields against closed forms and float64 sums, and surfaces behind shells."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.render.quadrature import quadrature
from ndf_mi.render.surfaces import next_surface, occluded
from ndf_mi.render.transport import Performer, Transport


@dataclass
class Ball:
    """Density `sigma` and one colour inside a ball around (0, 0, centre)."""

    sigma: mi.Float
    colour: tuple = (0.25, 0.5, 0.75)
    centre: float = 0.0
    radius: float = 1.0
    sample_factor: int = 1

    def __post_init__(self):
        middle = mi.Point3f(0, 0, self.centre)
        self.bbox = mi.BoundingBox3f(middle - self.radius, middle + self.radius)

    def may_contain(self, x):
        return dr.norm(x - mi.Point3f(0, 0, self.centre)) < self.radius

    def locate(self, x, active):
        return Located.anywhere(active & self.may_contain(x))

    def evaluate(self, x, d, located, active):
        sigma = self.sigma + dr.zeros(mi.Float, dr.width(x))
        return FieldSample(sigma, mi.Color3f(*self.colour), mi.Point3f(x), mi.Normal3f(0, 0, 1))

    def interval(self, x, y):
        """Where rays from z = −4 along z enter and leave, float64."""
        half = np.sqrt(np.maximum(self.radius**2 - x**2 - y**2, 0))
        return 4 + self.centre - half, 4 + self.centre + half


def rays(n, seed=0, maxt=np.inf):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1.2, 1.2, (2, n)).astype(np.float32)
    ray = mi.Ray3f(mi.Point3f(np.stack([x, y, np.full(n, -4, np.float32)])),
                   mi.Vector3f(0, 0, 1) + dr.zeros(mi.Vector3f, n))
    ray.maxt = mi.Float(np.broadcast_to(np.float32(maxt), n).copy())
    dr.make_opaque(ray)
    return ray, x.astype(np.float64), y.astype(np.float64)


def reference(balls, x, y, end):
    """Transmittance (N) and light (N, 3) up to the distance `end`, in float64: between neighbouring ends of
    intervals everything is
    constant, and each stretch has its closed form."""
    bounds = np.stack([b.interval(x, y) for b in balls])
    nodes = np.sort(np.minimum(np.concatenate([bounds.reshape(-1, len(x)), np.zeros((1, len(x))), end[None]]),
                               end), axis=0)
    light, depth = np.zeros((len(x), 3)), np.zeros(len(x))
    for a, b in zip(nodes[:-1], nodes[1:], strict=True):
        inside = (bounds[:, 0] < (a + b) / 2) & ((a + b) / 2 < bounds[:, 1])
        sigma = inside * np.array([float(ball.sigma[0]) for ball in balls])[:, None]
        colour = np.einsum("kn,kc->nc", sigma,
                           [ball.colour for ball in balls]) / np.maximum(sigma.sum(0), 1e-30)[:, None]
        light += (np.exp(-depth) * -np.expm1(-sigma.sum(0) * (b - a)))[:, None] * colour
        depth += sigma.sum(0) * (b - a)
    return np.exp(-depth), light


def colours(crossing):
    return np.moveaxis(crossing.colour.numpy(), 0, -1)


def test_one_field_is_what_the_quadrature_gives():
    """Over more than one tile, with and without jitter, and with a ray's end inside."""
    ray, *_ = rays(300, maxt=np.random.default_rng(2).uniform(3, 6, 300))
    offset = mi.Float(np.random.default_rng(3).random(300, dtype=np.float32))
    for jitter in (None, offset):
        ball = Ball(mi.Float(2.0), sample_factor=2)
        expected = quadrature(ball, ray, 32, jitter=None if jitter is None else dr.repeat(jitter, 64))
        seen = Transport(32, tile=128)([Performer(ball)], ray, True, jitter)
        np.testing.assert_allclose(colours(seen), np.moveaxis(expected.colour.numpy(), 0, -1), atol=1e-6)
        np.testing.assert_allclose(seen.transmittance.numpy(), 1 - expected.opacity.numpy(), atol=1e-6)
        np.testing.assert_allclose(seen.depth.numpy(), expected.depth.numpy() * expected.opacity.numpy(),
                                   atol=1e-5)


@pytest.mark.parametrize("sigma", [1e-3, 1.0, 20.0])
def test_a_segment_ends_at_its_surface(sigma):
    end = np.random.default_rng(1).uniform(2.8, 5.2, 400).astype(np.float32)
    ray, x, y = rays(400, maxt=end)
    ball = Ball(mi.Float(sigma))
    seen = Transport(2000)([Performer(ball)], ray)
    transmittance, light = reference([ball], x, y, end.astype(np.float64))
    step = 2 * sigma * 2 / 2000
    np.testing.assert_allclose(seen.transmittance.numpy(), transmittance, atol=step)
    np.testing.assert_allclose(colours(seen), light, atol=step)


@pytest.mark.parametrize("centre", [0.0, 0.7, -0.7, 1.9, 2.5],
                         ids=["together", "behind", "before", "touching", "apart"])
def test_two_fields_absorb_and_emit_together(centre):
    """Whichever is first, and however they overlap; the error falls with the samples."""
    ray, x, y = rays(400, maxt=6.2)
    balls = [Ball(mi.Float(1.5), (0.9, 0.1, 0.0)), Ball(mi.Float(4.0), (0.0, 0.2, 0.8), centre, 0.8)]
    transmittance, light = reference(balls, x, y, np.full(400, 6.2))
    error = []
    for samples in (60, 960):
        seen = Transport(samples)([Performer(ball) for ball in balls], ray)
        error.append([np.abs(seen.transmittance.numpy() - transmittance).mean(),
                      np.abs(colours(seen) - light).mean()])
        # What is emitted and what gets through add up to 1 in a furnace.
        white = [Performer(Ball(b.sigma, (1.0, 1.0, 1.0), b.centre, b.radius)) for b in balls]
        one = Transport(samples)(white, ray)
        np.testing.assert_allclose(colours(one)[:, 0] + one.transmittance.numpy(), 1, atol=8.0 / samples)
    assert max(error[1]) < 2e-3 and (np.array(error[1]) < 0.25 * np.array(error[0])).all()


def test_two_of_one_kind_are_one_of_twice_the_density():
    ray, *_ = rays(200)
    one = Transport(50)([Performer(Ball(mi.Float(3.0)))], ray)
    scaled = Transport(50)([Performer(Ball(mi.Float(1.0)), 3.0)], ray)
    two = Transport(50)([Performer(Ball(mi.Float(1.0))), Performer(Ball(mi.Float(2.0)))], ray)
    for other in (scaled, two):
        np.testing.assert_allclose(colours(other), colours(one), atol=2e-6)
        np.testing.assert_allclose(other.transmittance.numpy(), one.transmittance.numpy(), atol=2e-6)


def test_rays_beside_all_boxes_and_inactive_rays_cost_nothing():
    ray, x, y = rays(200)
    ray.o = mi.Point3f(ray.o.x + 5, ray.o.y, ray.o.z)
    dr.make_opaque(ray)
    transport = Transport(64)
    seen = transport([Performer(Ball(mi.Float(3.0)))], ray)
    assert (colours(seen) == 0).all() and (seen.transmittance.numpy() == 1).all() and transport.evaluated == 0
    ray, x, y = rays(200)
    seen = transport([Performer(Ball(mi.Float(3.0)))], ray, dr.arange(mi.UInt32, 200) < 100)
    assert (seen.transmittance.numpy()[100:] == 1).all() and (seen.transmittance.numpy()[:100] < 0.5).any()


def test_gradients_of_overlapping_fields_agree_with_finite_differences():
    ray, *_ = rays(200)

    def value(a, b):
        seen = Transport(40, tile=64)([Performer(Ball(a)), Performer(Ball(b, (0.9, 0.1, 0.3), 0.5))], ray)
        return dr.sum(seen.colour.x * 0.7 + seen.colour.z) - dr.sum(seen.transmittance * ray.o.x)

    a, b = mi.Float(0.8), mi.Float(1.7)
    dr.enable_grad(a, b)
    dr.backward(value(a, b))
    for k, gradient in enumerate((dr.grad(a)[0], dr.grad(b)[0])):
        ahead, behind = (float(value(*(mi.Float(v + h * (i == k)) for i, v in enumerate((0.8, 1.7))))[0])
                         for h in (1e-2, -1e-2))
        assert float(gradient) == pytest.approx((ahead - behind) / 2e-2, rel=2e-3)


def scene(**more):
    """A wall 7 m away, behind two null shells. It has to be kept while anything traced in it is unevaluated.
    """
    null = {"type": "null"}
    return mi.load_dict({
        "type": "scene",
        "shell": {"type": "sphere", "radius": 1.0, "bsdf": null},
        "outer": {"type": "cube", "bsdf": null, "to_world": mi.ScalarTransform4f().scale(1.5)},
        "wall": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).scale(5)},
        **more,
    })


def test_null_shapes_are_passed_through_without_moving_the_ray():
    ray, x, y = rays(500)
    world = scene()
    found = next_surface(world, ray, True)
    si = found.compute_surface_interaction(ray, +mi.RayFlags.All, True)
    np.testing.assert_allclose(found.t.numpy(), 7, rtol=1e-6)
    np.testing.assert_allclose(si.p.numpy(), np.stack([x, y, np.full(500, 3)]), atol=2e-6)
    assert occluded(world, ray, True).numpy().all()


def test_rays_end_at_maxt():
    world = scene()
    for end, hit in ((6.9, False), (7.1, True), (3.5, False)):
        ray, *_ = rays(50, maxt=end)
        assert (occluded(world, ray, True).numpy() == hit).all()
    ray, *_ = rays(50)
    assert not occluded(world, ray, dr.arange(mi.UInt32, 50) > 100).numpy().any()


def test_a_surface_close_behind_a_shell_is_not_jumped_over():
    ray, *_ = rays(500)
    world = scene(sheet={"type": "rectangle",
                         "to_world": mi.ScalarTransform4f().translate([0, 0, -1.5 + 2e-5]).scale(5)})
    assert (next_surface(world, ray, True).t.numpy() < 2.6).all()


def test_shapes_that_emit_are_met_unless_skipped():
    world = scene(light={"type": "rectangle", "bsdf": {"type": "null"},
                         "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(5),
                         "emitter": {"type": "area", "radiance": 1.0}})
    ray, *_ = rays(50)
    np.testing.assert_allclose(next_surface(world, ray, True).t.numpy(), 2, rtol=1e-6)
    np.testing.assert_allclose(next_surface(world, ray, True, skip_emitters=True).t.numpy(), 7, rtol=1e-6)
