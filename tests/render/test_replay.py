"""What lies behind a medium, and gradients through it, against Beer's law."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.render.replay import Replay, repeated

BEHIND = (0.5, 0.25, 1.0)
COUNT = 1 << 16


@pytest.mark.parametrize("sigma", [0.4, 3.0])
def test_background_and_its_gradients_follow_beers_law(sigma):
    """A black slab of thickness 1 on a lattice, majorant above its density: what is seen is the background, weakened."""
    medium = mi.load_dict({"type": "ndf_lattice", "nx": 4, "ny": 4, "nz": 4, "cell": 1.0})
    nodes = np.zeros((64, 4), np.float32)
    nodes[:, 0] = sigma
    values = mi.Float(nodes.ravel())
    dr.enable_grad(values)
    medium.fill(values, mi.Point3f(-1.5), mi.Float(1.5 * sigma))
    slab = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(0.5), "bsdf": {"type": "null"}, "interior": medium}
    scene = mi.load_dict({"type": "scene", "slab": slab, "light": {"type": "constant", "radiance": 7.0}})
    replay = Replay(scene, mi.load_dict({"type": "prbvolpath", "hide_emitters": True}), mi.Color3f(*BEHIND))
    ray = repeated(mi.Ray3f(mi.Point3f(0.1, 0.2, 3.0), mi.Vector3f(0, 0, -1)), COUNT)
    radiance = replay.radiance(ray, 1)
    share = np.array([dr.mean(channel)[0] for channel in radiance]) / BEHIND
    error = np.sqrt(np.exp(-sigma) * (1 - np.exp(-sigma)) / COUNT)
    np.testing.assert_allclose(share, np.exp(-sigma), atol=4 * error)
    replay.backward(ray, 1, radiance, mi.Color3f(1.0 / COUNT, 0, 0))
    # All densities raised alike: ∂(B·exp(−σ))/∂σ.
    found = dr.grad(values).numpy().reshape(64, 4)[:, 0].sum()
    assert found == pytest.approx(-BEHIND[0] * np.exp(-sigma), rel=0.04)


def test_rays_are_repeated_beside_one_another():
    ray = repeated(mi.Ray3f(mi.Point3f([0, 1], [2, 3], [4, 5]), mi.Vector3f(0, 0, 1)), 3)
    assert ray.o.x.numpy().tolist() == [0, 0, 0, 1, 1, 1] and dr.width(ray.d) == 6


def test_paths_of_one_seed_are_the_same_and_of_others_not():
    scene = mi.load_dict({"type": "scene", "light": {"type": "constant"}, "ball": {"type": "sphere"}})
    replay = Replay(scene, mi.load_dict({"type": "prb", "hide_emitters": True}), mi.Color3f(0.0))
    ray = repeated(mi.Ray3f(mi.Point3f(0, 0, 3.0), mi.Vector3f(0, 0, -1)), 64)
    first, again, other = (replay.radiance(ray, seed).numpy() for seed in (1, 1, 2))
    assert (first == again).all() and first.shape == (3, 64)
    assert other.shape == first.shape
