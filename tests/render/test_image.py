"""Whole images: looking at rays front to back, in rounds, gives what looking at them whole gives."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.render.image import ImageRenderer


@dataclass
class Parallel:
    """A camera of parallel rays along z, over the square of side 2.4."""

    w: int = 12
    h: int = 12

    def rays(self, pixels: mi.Point2f) -> mi.Ray3f:
        """The rays through pixel coordinates."""
        return mi.Ray3f(mi.Point3f(2.4 * pixels.x / self.w - 1.2, 2.4 * pixels.y / self.h - 1.2, -4.0),
                        mi.Vector3f(0, 0, 1))


class Ball:
    """Constant density inside the unit ball, coloured by position; counts the samples that it is asked for.
    """

    sample_factor = 1

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma
        self.asked = 0
        self.bbox = mi.BoundingBox3f(mi.Point3f(-1), mi.Point3f(1))

    def may_contain(self, x):
        return dr.norm(x) < 1

    def locate(self, x, active):
        return Located.anywhere(active & (dr.norm(x) < 1))

    def evaluate(self, x, d, located, active):
        self.asked += int(dr.count(active)[0])
        sigma = mi.Float(self.sigma) + dr.zeros(mi.Float, dr.width(x))
        return FieldSample(sigma, mi.Color3f(0.5 + 0.5 * x.x, 0.5 + 0.5 * x.y, 0.5 + 0.5 * x.z),
                           mi.Point3f(x), mi.Normal3f(x))


@pytest.mark.parametrize("samples", [64, 63, 1])
@pytest.mark.parametrize("sigma", [0.0, 0.3, 20.0])
def test_rounds_change_nothing(sigma, samples):
    whole = ImageRenderer(samples, spp=2, rounds=1, cutoff=0.0)(Ball(sigma), Parallel(), geometry=True)
    parts = ImageRenderer(samples, spp=2, rounds=4, cutoff=0.0)(Ball(sigma), Parallel(), geometry=True)
    for name in ("linear", "opacity", "depth", "u", "normal"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), atol=3e-5)


def test_an_opaque_ball_hides_what_is_behind():
    """exp(−9.2) is 1e-4: a ray goes on until it has gone half a unit through a density of 20."""
    through, cut = Ball(20.0), Ball(20.0)
    whole = ImageRenderer(64, cutoff=0.0)(through, Parallel(), geometry=True)
    parts = ImageRenderer(64)(cut, Parallel(), geometry=True)
    assert cut.asked < 0.7 * through.asked
    for name in ("linear", "opacity", "u", "normal"):
        assert 0 < np.abs(getattr(parts, name) - getattr(whole, name)).max() < 1.1e-4
    np.testing.assert_allclose(parts.depth, whole.depth, atol=5e-4)
    # The closed form: opacity of a chord, L = 1 − exp(−σ·2·sqrt(1 − r²)), up to half a stratum at either end.
    x = 2.4 * (np.arange(12) + 0.5) / 12 - 1.2
    r2 = np.add.outer(x**2, x**2)
    chord = 2 * np.sqrt(np.maximum(1 - r2, 0))
    inside = chord > 0.5
    np.testing.assert_allclose(parts.opacity[inside], (1 - np.exp(-20 * chord))[inside], atol=2e-4)


def test_depth_of_a_silhouette_is_a_mean_over_what_is_seen():
    """Of sixteen rays a pixel some miss the ball: they have no depth, and take nothing from that of the
    others."""
    image = ImageRenderer(64, spp=16)(Ball(200.0), Parallel(), geometry=True)
    edge = (image.opacity > 0.2) & (image.opacity < 0.8)
    assert edge.sum() >= 4
    # The ball's front lies between 3 and 4 metres from the camera, and its normals have unit length at every
    # ray.
    assert ((image.depth[edge] > 3) & (image.depth[edge] < 4.1)).all()
    assert (np.linalg.norm(image.normal[edge], axis=-1) > 0.8).all()


def test_shifted_samples_are_the_same_every_time_and_right_on_average():
    """A shift that is uniform over a stratum makes the mean over many rays the integral: here of a ball that
    one sample a ray can miss."""
    first = ImageRenderer(2, spp=64, stratified=True, cutoff=0.0)(Ball(1.0), Parallel())
    again = ImageRenderer(2, spp=64, stratified=True, cutoff=0.0)(Ball(1.0), Parallel())
    assert (first.linear == again.linear).all()
    middles = ImageRenderer(2, spp=64, cutoff=0.0)(Ball(1.0), Parallel())
    truth = ImageRenderer(256, spp=64, cutoff=0.0)(Ball(1.0), Parallel())
    near = (truth.opacity > 0.1) & (truth.opacity < 0.6)
    error, other = (np.sqrt(np.mean(np.square((image.opacity - truth.opacity)[near])))
                    for image in (first, middles))
    assert error < 0.5 * other


def test_shifts_do_not_depend_on_rounds():
    whole = ImageRenderer(16, rounds=1, cutoff=0.0, stratified=True)(Ball(3.0), Parallel())
    parts = ImageRenderer(16, rounds=4, cutoff=0.0, stratified=True)(Ball(3.0), Parallel())
    np.testing.assert_allclose(parts.linear, whole.linear, atol=3e-5)


def test_work_counts_what_was_asked_for():
    ball = Ball(0.3)
    renderer = ImageRenderer(16, cutoff=0.0)
    work = renderer(ball, Parallel()).work
    # Ten of the twelve columns, and rows, of pixels look at the cube around the ball.
    assert 100 <= work.rays == renderer.met(ball, Parallel()) <= 144
    assert work.candidates == 16 * work.rays and work.evaluated == ball.asked and work.tiles == 4
    # Each tile's few samples take the least array there is.
    assert work.launched == 4 * 2048
    assert work.lanes == 4 * renderer.tiling(1, work.rays)[2] * 4 >= work.candidates


@pytest.mark.parametrize("change", [{"samples": 0}, {"spp": 0}, {"cutoff": 1.0}, {"cutoff": -0.1}])
def test_what_cannot_be_rendered_with_is_refused(change):
    with pytest.raises(InputError):
        ImageRenderer(**change)


@pytest.mark.parametrize("sigma", [np.nan, -np.inf])
def test_what_is_not_finite_is_refused(sigma):
    with pytest.raises(InputError, match="NaN or infinity along .* rays(.|\n)*--networks half"):
        ImageRenderer(16)(Ball(sigma), Parallel())
