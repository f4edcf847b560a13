"""Trained primitives in a Mitsuba scene."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.methods.base import Budget
from ndf_mi.methods.gaussians.hits import Rectangle
from ndf_mi.methods.gaussians.method import Gaussians
from ndf_mi.methods.gaussians.scene import performer
from ndf_mi.methods.gaussians.training import Settings, see
from ndf_mi.methods.volume.optimisation import Schedule


def test_a_scene_shows_the_performer_as_the_method_does(capture, tmp_path):
    method = Gaussians(Settings(spacing=3.0, surface="body", rounds=0, schedule=Schedule(30, 1e-2)))
    method.fit(capture, Budget(seed=1))
    method.save(tmp_path)
    camera = capture.cameras["n0"]
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "volprim_rf_basic"},
        "sensor": camera.sensor(spp=64, sampler="multijitter"),
        "performer": performer(tmp_path, capture, 7)})
    picture = mi.render(scene, spp=64).numpy()[..., :3]

    fine = camera.scaled(6 * camera.w, 6 * camera.h)
    colour, _, _ = see(method.posed(7), Rectangle(fine, 0, 0, fine.w, fine.h))
    linear = srgb_to_linear(np.array(colour).T.reshape(camera.h, 6, camera.w, 6, 3)).mean((1, 3))
    difference = linear_to_srgb(picture) - linear_to_srgb(linear)
    assert linear.max() > 0.2 and np.sqrt(np.square(difference).mean()) < 0.01
