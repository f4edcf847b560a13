"""What the networks take for a place: each kind against its definition, in float64 from points whose
projection is known."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import RADIUS, ball

from ndf_mi.coordinates import Coordinates
from ndf_mi.errors import InputError
from ndf_mi.field import PRESETS, preset
from ndf_mi.projection import PosedSurface, Surface

TINY = dataclasses.replace(preset("tiny"), band=0.08, band_inside=0.04)


def around_the_ball(changes, n=500, frame=2):
    """Random points within 3 cm of the posed ball, their signed distance, direction and what the networks
    would see."""
    body, poses = ball()
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = rng.uniform(-0.03, 0.03, n)
    centre = poses.translation[frame].astype(np.float64)
    x = centre + direction * (RADIUS + distance)[:, None]
    changed = dataclasses.replace(TINY, **changes)
    surface = PosedSurface(Surface(body.faces, body.uv, body.uv_faces, poses.vertices[0]),
                           mi.Float(poses.vertices[frame].ravel()), 0.08)
    points = mi.Point3f(x.T.astype(np.float32))
    found = surface.project(points)
    values = Coordinates(changed, body, poses)(points, found, found.valid)
    assert len(values) == changed.dimension
    return np.stack([v.numpy() for v in values], 1).astype(np.float64), x, direction, distance, found


def test_distances():
    # The ball is of triangles: up to 1.5 mm within the sphere.
    facets = 2e-3
    signed, _, _, distance, _ = around_the_ball({})
    assert np.abs(signed[:, 2] - (distance + 0.04) / 0.12).max() < facets / 0.12
    unsigned, _, _, distance, _ = around_the_ball({"distance": "unsigned"})
    assert np.abs(unsigned[:, 2] - np.abs(distance) / 0.08).max() < facets / 0.08
    none, _, _, _, _ = around_the_ball({"distance": "none"})
    np.testing.assert_allclose(none[:, 2], 0.04 / 0.12, rtol=1e-6)
    assert (none[:, :2] == signed[:, :2]).all()


def test_the_surface_point_is_at_rest_and_knows_no_seam():
    values, _, direction, distance, _ = around_the_ball({"coordinates": "surface"})
    # The rest pose is the ball around the origin, in a cube of its diameter.
    expected = 0.5 + 0.5 * direction
    assert np.abs(values[:, :3] - expected).max() < 0.012
    assert np.abs(values[:, 3] - (distance + 0.04) / 0.12).max() < 0.02


def test_the_world_is_one_cube_around_all_poses():
    values, x, _, _, _ = around_the_ball({"coordinates": "world"})
    low = np.array([-RADIUS - 0.08] * 3)
    extent = 2 * RADIUS + 0.1 + 0.16
    np.testing.assert_allclose(values, (x - low) / extent, atol=1e-3)


@pytest.mark.parametrize("kind", ["uv", "surface", "world"])
def test_every_kind_is_attached_to_the_point_and_finite_where_masked(kind):
    body, poses = ball()
    surface = PosedSurface(Surface(body.faces, body.uv, body.uv_faces, poses.vertices[0]),
                           mi.Float(poses.vertices[0].ravel()), 0.08)
    x = mi.Point3f([0.1, 0.2, np.nan], [0.2, -0.1, np.nan], [0.25, 0.24, np.nan])
    dr.enable_grad(x)
    found = surface.project(x, mi.Bool([True, True, False]))
    values = Coordinates(dataclasses.replace(TINY, coordinates=kind), body, poses)(x, found, found.valid)
    dr.backward(sum(dr.sum(v) for v in values))
    gradient = dr.grad(x).numpy()
    assert all(np.isfinite(v.numpy()).all() for v in values)
    assert np.isfinite(gradient).all()
    assert (np.abs(gradient[:, :2]).max(0) > 0).all() and (gradient[:, 2] == 0).all()


@pytest.mark.parametrize("name", list(PRESETS))
@pytest.mark.parametrize("changes",
                         [{"coordinates": "surface"}, {"coordinates": "world"}, {"distance": "none"},
                          {"distance": "unsigned"},
                                     {"pose_layers": ()}, {"deformation_layers": ()}])
def test_batched_and_fused_agree_on_every_kind(make_run, name, changes):
    small = {"density_layers": (32, 32), "density_skip": 0} if name == "paper" else {}
    options = dataclasses.asdict(preset(name)) | small | changes
    posed = make_run(**options).posed(0)
    posed.bound.pack()
    rng = np.random.default_rng(1)
    x = mi.Point3f(rng.uniform(-0.35, 0.35, (3, 2000)).astype(np.float32))
    d = mi.Vector3f(0, 0, 1) + dr.zeros(mi.Vector3f, 2000)
    located = posed.locate(x, mi.Bool(True))
    batched, fused = posed.evaluate(x, d, located, located.valid), posed.fused(x, d)
    limit = posed.bound.preset.density_limit
    np.testing.assert_allclose(batched.sigma.numpy(), fused.sigma.numpy(), atol=1e-5 * limit)
    np.testing.assert_allclose(batched.colour.numpy()[:, located.valid.numpy()],
                               fused.colour.numpy()[:, located.valid.numpy()], atol=1e-4)


def test_without_a_pose_network_nothing_depends_on_the_pose(make_run):
    run = make_run(pose_layers=())
    x = mi.Point3f([0.1, 0.2], [0.2, -0.1], [0.25, 0.24])
    d = mi.Vector3f(0, 0, 1) + dr.zeros(mi.Vector3f, 2)
    one, other = (run.posed_as(run.poses.vertices[0], run.poses.pose[frame]) for frame in (0, 2))
    located = one.locate(x, mi.Bool(True))
    assert located.valid.numpy().all()
    for mine, its in zip(*((s.sigma, *s.colour)
                           for s in (p.evaluate(x, d, located, located.valid) for p in (one, other))),
                           strict=True):
        assert (mine.numpy() == its.numpy()).all()


@pytest.mark.parametrize("key, value", [("coordinates", "uvw"), ("distance", "half"), ("sample_factor", 0)])
def test_wrong_kinds_are_named(key, value):
    with pytest.raises(InputError, match=key):
        dataclasses.replace(TINY, **{key: value})
