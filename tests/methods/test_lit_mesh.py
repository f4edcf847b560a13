"""The diffuse mesh: its reflectance recovered from images, and its brightness in known light."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.experiments import metrics
from ndf_mi.methods.base import Light
from ndf_mi.methods.lit_mesh import LitMesh
from ndf_mi.methods.lit_surface import LitSurface, ReflectanceFit
from ndf_mi.render.lights import lights
from ndf_mi.surface.schedule import Schedule, train_steps


@pytest.fixture
def captures(make_constant_run, lit_capture):
    truth = make_constant_run(
        25.0, srgb=(0.9, 0.7, 0.5), name="truth", direction_octaves=-1, normal_octaves=-1
    )
    return lit_capture(truth, "day"), lit_capture(truth, "night")


@pytest.mark.long
def test_it_recovers_a_reflectance_and_shows_it_in_another_light(captures):
    """The truth here is the mesh itself with a plain texture, path traced by Mitsuba."""
    capture = captures[0]
    grey = np.full((16, 16, 3), (0.7, 0.5, 0.3), dtype=np.float32)
    known = {
        name: Light(name, lights(c.known_lighting()))
        for name, c in zip(("day", "night"), captures, strict=True)
    }
    shown = {}
    for name, light in known.items():
        mesh = LitMesh(capture, grey, light, 64, {"capture": ""})
        shown[name] = {
            (camera, frame): mesh.render(capture.cameras[camera], frame)
            for camera in capture.cameras
            for frame in (0, 1)
        }
    capture.image = lambda camera, frame: shown["day"][camera, frame]
    fit = ReflectanceFit(LitSurface(capture, 16, known["day"].emitters), capture, 16, 0.05, 0)
    train_steps(fit, Schedule(), 60)
    seen = fit.texels.seen()
    assert np.abs(fit.texels.values()[seen].mean(0) - grey[0, 0]).max() < 0.03
    found = np.where(seen[..., None], fit.texels.values(), grey)
    image = LitMesh(capture, found, known["night"], 64, {"capture": ""}).render(capture.cameras["n0"], 1)
    mask = metrics.box_mask(capture.cameras["n0"], capture.poses.vertices[1])
    assert metrics.psnr(shown["night"]["n0", 1], image, mask) > 28


def test_a_diffuse_ball_in_white_light_has_the_brightness_of_its_albedo(captures):
    """In the furnace a convex diffuse body is seen with radiance albedo × sky."""
    capture = captures[0]
    texture = np.full((8, 8, 3), 0.735357, dtype=np.float32)  # sRGB of 0.5
    mesh = LitMesh(
        capture, texture, Light("sky", {"sky": mi.load_dict({"type": "constant"})}), 256, {"capture": ""}
    )
    middle = mesh.render(capture.cameras["c0"], 0)[10:14, 10:14]
    np.testing.assert_allclose(middle.mean((0, 1)), 0.7354, atol=0.01)
    assert mesh.metadata()["noise_psnr"] > 30
