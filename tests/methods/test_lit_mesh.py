"""The diffuse mesh: its reflectance recovered from images, and its brightness in known light."""

from __future__ import annotations

import copy

import mitsuba as mi
import numpy as np
import pytest
from lit_capture import LIGHTS

from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.methods.base import Budget, Light
from ndf_mi.methods.lit_mesh import LitMesh, RelightableMesh
from ndf_mi.methods.lit_surface import LitSurface
from ndf_mi.render.scene import lights
from ndf_mi.surface.schedule import Schedule, train_steps
from ndf_mi.surface.texture_fit import TextureFit


@pytest.mark.long
def test_it_recovers_a_reflectance_and_shows_it_in_another_light(capture, tmp_path):
    """The truth here is the mesh itself with a plain texture, path traced by Mitsuba."""
    known = {}
    for name, emitters in LIGHTS.items():
        (tmp_path / f"{name}.xml").write_text(f'<scene version="3.0.0">{emitters}</scene>')
        known[name] = Light(name, lights(tmp_path / f"{name}.xml"))
    cameras = {name: camera.scaled(24, 24) for name, camera in capture.cameras.items()}
    lit = copy.copy(capture)
    lit.cameras = cameras
    plain = np.full((16, 16, 3), (0.7, 0.5, 0.3), dtype=np.float32)
    day = LitMesh(capture, plain, known["day"], 64, {"capture": ""})
    shown = {view: day.render(cameras[view[0]], view[1]) for view in capture.splits["train"]}
    lit.image = lambda camera, frame: shown[camera, frame]
    lit.mask = lambda camera, frame: np.abs(shown[camera, frame] - capture.background).max(-1) > 0.02
    fit = TextureFit(LitSurface(lit, 16, known["day"].emitters), lit, 16, 0.05, 0)
    train_steps(fit, Schedule(), 60)
    seen = fit.texels.seen()
    assert np.abs(fit.texels.values()[seen].mean(0) - plain[0, 0]).max() < 0.03
    found = np.where(seen[..., None], fit.texels.values(), plain)
    truth, image = (
        LitMesh(lit, texture, known["night"], 64, {"capture": ""}).render(cameras["n0"], 5)
        for texture in (plain, found)
    )
    mask = metrics.box_mask(cameras["n0"], capture.poses.vertices[capture.poses.index(5)])
    assert metrics.psnr(truth, image, mask) > 28


def test_a_diffuse_ball_in_white_light_has_the_brightness_of_its_albedo(capture):
    """In the furnace a convex diffuse body is seen with radiance albedo × sky."""
    texture = np.full((8, 8, 3), 0.735357, dtype=np.float32)  # sRGB of 0.5
    sky = Light("sky", {"sky": mi.load_dict({"type": "constant"})})
    mesh = LitMesh(capture, texture, sky, 256, {"capture": ""})
    assert "noise_psnr" not in mesh.metadata()
    middle = mesh.render(capture.cameras["c0"].scaled(24, 24), 2)[10:14, 10:14]
    np.testing.assert_allclose(middle.mean((0, 1)), 0.7354, atol=0.01)
    assert mesh.metadata()["noise_psnr"] > 30


def test_a_capture_of_unknown_light_is_refused(capture):
    with pytest.raises(InputError, match="lighting"):
        RelightableMesh(8).fit(capture, Budget())
