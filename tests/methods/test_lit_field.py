"""The field of a run in some light."""

from __future__ import annotations

import numpy as np
import pytest
from sphere_capture import ring_camera

from ndf_mi.errors import InputError
from ndf_mi.learn.scattering_scene import expect_outside
from ndf_mi.methods.base import Light
from ndf_mi.methods.lit_field import LitField
from ndf_mi.render.scene import lights

DARK = Light("dark", {})


def lit(run, light: Light, spp: int, spacing: float = 0.0) -> LitField:
    return LitField(run, light, [1], spp, spacing, {"max_depth": 6})


@pytest.mark.long
def test_a_grid_shows_what_the_field_itself_shows(make_constant_run, lit_capture):
    """Constant extinction and albedo: except at the band's edges, where the grid smooths over a cell, both
    are the same medium.
    """
    run = make_constant_run(25.0, srgb=(0.9, 0.7, 0.5), direction_octaves=-1, normal_octaves=-1)
    capture = lit_capture(run, "day")
    images, noise = [], 0.0
    for spacing in (0.0, 0.01):
        method = lit(run, Light("day", lights(capture.known_lighting())), 64, spacing)
        images.append(method.render(capture.cameras["n0"], 1))
        noise += 10 ** (-method.metadata()["noise_psnr"] / 10)
    inside = capture.mask("n0", 1)
    bias = (images[1] - images[0])[inside].mean(0)
    assert np.abs(bias).max() < 0.01 + 3 * np.sqrt(noise / inside.sum())


def test_its_cache_key_depends_on_grid_light_and_samples(make_constant_run):
    run = make_constant_run(25.0)
    keys = [
        lit(run, DARK, 2).cache_key(),
        lit(run, DARK, 4).cache_key(),
        lit(run, Light("other", {}), 2).cache_key(),
    ]
    assert len(set(keys)) == 3 and lit(run, DARK, 2).cache_key() == keys[0]


def test_a_camera_inside_the_band_is_refused(make_constant_run):
    """Cameras outside the band and its shell are accepted."""
    run = make_constant_run(25.0)
    camera = ring_camera("close", 0.0)
    for distance, inside in ((0.36, True), (0.41, True), (0.45, False), (2.0, False)):
        camera.transform[:3, 3] = [0.05, 0, distance]
        if not inside:
            expect_outside(run, camera, 1)
            continue
        with pytest.raises(InputError, match="'close'.*frame 1.*band"):
            lit(run, DARK, 2).render(camera, 1)
