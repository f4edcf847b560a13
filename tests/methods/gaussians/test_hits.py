"""The lists of primitives that rays meet."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
from sphere_capture import ring_camera

from ndf_mi.methods.gaussians.compositing import Hits, Posed, composite
from ndf_mi.methods.gaussians.hits import Rectangle, find_hits

WHOLE = Rectangle(ring_camera("c", 0.3, size=24), 0, 0, 24, 24)


def one(centre: tuple[float, float, float], scale: tuple[float, float, float], opacity: float = 0.9) -> Posed:
    turn = np.array([0.3, -0.5, 0.2, 0.8]) / np.linalg.norm([0.3, -0.5, 0.2, 0.8])
    return Posed(mi.Point3f(*map(mi.Float, centre)), mi.Vector3f(*map(mi.Float, scale)),
                 mi.Quaternion4f(*map(mi.Float, turn)), mi.Float(opacity), mi.Color3f(mi.Float(1), 0.5, 0.2))


def met(posed: Posed, *parts: Rectangle) -> tuple[Hits, mi.Point3f, mi.Vector3f]:
    origin, direction = (np.concatenate(sides, 1).astype(np.float32)
                         for sides in zip(*(part.rays() for part in parts), strict=True))
    rays = mi.Point3f(origin), mi.Vector3f(direction)
    return find_hits(posed, parts, *rays), *rays


def test_a_rectangle_sees_what_the_whole_image_shows_there():
    posed = one((0.1, 0.05, 0.3), (0.2, 0.05, 0.01))
    opacity = np.array(composite(posed, *met(posed, WHOLE))[1]).reshape(24, 24)
    assert opacity.max() > 0.5 and opacity[0].max() == 0
    part = dataclasses.replace(WHOLE, x=9, y=7, width=8, height=10)
    hits, *rays = met(posed, part, WHOLE)
    both = np.array(composite(posed, hits, *rays)[1])
    np.testing.assert_allclose(both[:80].reshape(10, 8), opacity[7:17, 9:17], atol=1e-6)
    np.testing.assert_allclose(both[80:].reshape(24, 24), opacity, atol=1e-6)


def test_bounds_leave_out_no_pixel():
    """Rays through every pixel are tested against an ellipsoid that reaches far to the side."""
    posed = one((0.9, 0.2, 1.0), (0.25, 0.1, 0.02))
    hits, _, direction = met(posed, WHOLE)
    origin, _ = WHOLE.rays()
    matrix = np.array(posed.whitening(), np.float64)[..., 0]
    start = matrix @ (origin - np.array(posed.centre, np.float64))
    step = matrix @ np.array(direction, np.float64)
    nearest = start - step * ((start * step).sum(0) / (step * step).sum(0))
    expected = np.flatnonzero((nearest**2).sum(0) < 9)
    assert len(expected) > 15
    np.testing.assert_array_equal(np.array(hits.ray)[np.array(hits.real)], expected)


def test_rays_end_behind_what_is_opaque_and_primitives_behind_the_camera_are_unseen():
    layers = [one((0, 0, 0.3 - 0.1 * i), (0.3, 0.3, 0.3), 0.98) for i in range(4)]
    stacked = Posed(*(type(getattr(layers[0], f.name))(np.concatenate(
        [np.atleast_2d(np.array(getattr(layer, f.name))) for layer in layers], 1).squeeze())
        for f in dataclasses.fields(Posed)))
    hits, *_ = met(stacked, dataclasses.replace(WHOLE, x=12, y=12, width=1, height=1))
    assert int(dr.count(hits.real)[0]) == 2
    behind = one((0.7, 0.5, 3.0), (0.3, 0.3, 0.3))
    assert int(dr.count(met(behind, WHOLE)[0].real)[0]) == 0


def test_more_rays_than_sixteen_bits_count_are_kept_apart():
    part = Rectangle(ring_camera("c", 0.3, size=300), 0, 0, 300, 300)
    posed = one((0, 0, 0), (0.5, 0.5, 0.02))
    hits, *_ = met(posed, part)
    real = np.array(hits.real)
    ray, first = np.array(hits.ray, np.int64)[real], np.array(hits.first)[real]
    assert ray.max() > 65536 and (np.diff(ray) > 0).all()
    np.testing.assert_array_equal(first, np.arange(len(ray)))
