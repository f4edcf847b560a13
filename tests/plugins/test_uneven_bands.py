"""A band that varies over the body looks the same to every plugin: its transmittance against float64 sums, in
shells that follow it."""

import mitsuba as mi
import numpy as np
import pytest
from conftest import uneven
from field_scenes import BAND, RADIUS, SIZE, performer, scene_of

from ndf_mi.render.scene_issues import scene_issues

SIGMA = 6.0


@pytest.fixture
def run(make_constant_run):
    return make_constant_run(SIGMA, srgb=(1e-6,) * 3, bands=uneven(BAND, BAND, 0.2), direction_octaves=-1)


def expected(fov=28, distance=2.0, size=SIZE, fine=16):
    """(size, size) mean transmittance of each pixel."""
    at = np.tan(np.radians(fov) / 2) * (2 * (np.arange(size * fine) + 0.5) / (size * fine) - 1)
    x, y = np.meshgrid(at, -at)
    d = np.stack([x, y, -np.ones_like(x)], -1)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    depth, step = np.zeros(x.shape), 5e-4
    for s in np.arange(distance - 0.4, distance + 0.4, step) + step / 2:
        point = s * d + [0, 0, distance]
        r = np.linalg.norm(point, axis=-1)
        # The ball's vertices do not reach exactly to either end of x.
        width = BAND * (0.2 + 0.8 * (point[..., 0] / r + 1) / 2)
        depth += step * SIGMA * (np.abs(r - RADIUS) < width)
    return np.exp(-depth).reshape(size, fine, size, fine).mean((1, 3))


@pytest.mark.parametrize(("integrator", "more"), [
    ("ndf_quadrature", {"samples": 200}), ("ndf_path", {"samples": 200}), ("volpath", {}), ("prbvolpath", {}),
])
def test_the_picture_is_that_of_the_closed_form(run, integrator, more):
    scene = scene_of({"performer": performer(run, layers=0)}, integrator, **more)
    found = mi.render(scene, spp=2048 if "volpath" in integrator else 512, seed=1).numpy()[..., 0]
    truth = expected()
    # Uneven bands differ from left to right.
    assert np.abs(truth - truth[:, ::-1]).max() > 0.2
    # The ball is made of triangles, up to 2 mm within the sphere; grazing rays see most of that.
    np.testing.assert_allclose(found, truth, atol=0.05)
    assert abs(found.mean() - truth.mean()) < 0.006
    assert scene_issues(scene) == []


@pytest.mark.parametrize("medium", [{"layers": 3}, {"layers": 0, "grid_spacing": 0.004}])
def test_nested_shells_and_grids_follow_the_band(run, medium):
    scene = scene_of({"performer": performer(run, **medium)})
    found = mi.render(scene, spp=2048, seed=1).numpy()[..., 0]
    np.testing.assert_allclose(found, expected(), atol=0.05)
    assert abs(found.mean() - expected().mean()) < 0.006
