"""What lies behind a medium, and gradients through it, against Beer's law."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.render.replay import Replay, repeated

BEHIND = (0.5, 0.25, 1.0)
COUNT = 1 << 16


def slab_of(sigma, albedo, radiance):
    """Replay in a slab of thickness 1 on a grid, with a majorant above its density, under an even sky; rays;
    the nodes' values."""
    medium = mi.load_dict({"type": "ndf_grid", "nx": 4, "ny": 4, "nz": 4, "cell": 1.0})
    nodes = np.zeros((64, 4), np.float32)
    nodes[:] = sigma * np.array([1, albedo, albedo, albedo])
    values = mi.Float(nodes.ravel())
    dr.enable_grad(values)
    medium.fill(values, mi.Point3f(-1.5), mi.Float(max(1.5 * sigma, 1.0)))
    slab = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(0.5), "bsdf": {"type": "null"},
            "interior": medium}
    scene = mi.load_dict({"type": "scene", "slab": slab, "light": {"type": "constant", "radiance": radiance}})
    integrator = mi.load_dict({"type": "prbvolpath", "max_depth": 200, "rr_depth": 1000,
                               "hide_emitters": True})
    ray = repeated(mi.Ray3f(mi.Point3f(0.1, 0.2, 3.0), mi.Vector3f(0, 0, -1)), COUNT)
    return Replay(scene, integrator, mi.Color3f(*BEHIND)), ray, values


def raised(replay, ray, values, albedo, seed):
    """What the red radiance gains where all densities are raised alike, at one albedo, per 1/m."""
    dr.set_grad(values, 0)
    radiance = replay.radiance(ray, seed)
    replay.backward(ray, seed, radiance, mi.Color3f(1.0 / COUNT, 0, 0))
    return float((dr.grad(values).numpy().reshape(64, 4) @ [1, albedo, albedo, albedo]).sum())


@pytest.mark.parametrize("sigma", [0.05, 0.5, 3.0])
def test_gradients_in_a_furnace_are_those_of_the_background_alone(sigma):
    """Albedo 1 in a sky of 1: L = 1 − T + T·B however often light scatters, and ∂L/∂σ = (1 − B)·exp(−σ)."""
    replay, ray, values = slab_of(sigma, 1.0, 1.0)
    found = [raised(replay, ray, values, 1.0, seed) for seed in range(8)]
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    expected = (1 - BEHIND[0]) * np.exp(-sigma)
    assert abs(np.mean(found) - expected) < 4 * error + 1e-4
    assert error < 0.1 * expected


def test_at_zero_density_the_light_that_would_be_scattered_is_missing():
    """The bias that `docs/relighting.md` tells of: −B for 1 − B."""
    replay, ray, values = slab_of(0.0, 1.0, 1.0)
    found = [raised(replay, ray, values, 1.0, seed) for seed in range(4)]
    assert np.mean(found) == pytest.approx(-BEHIND[0], rel=0.05)


@pytest.mark.parametrize("sigma", [0.4, 3.0])
def test_background_and_its_gradients_follow_beers_law(sigma):
    """A black slab: what is seen is the background, weakened."""
    replay, ray, values = slab_of(sigma, 0.0, 7.0)
    radiance = replay.radiance(ray, 1)
    share = np.array([dr.mean(channel)[0] for channel in radiance]) / BEHIND
    error = np.sqrt(np.exp(-sigma) * (1 - np.exp(-sigma)) / COUNT)
    np.testing.assert_allclose(share, np.exp(-sigma), atol=4 * error)
    # ∂(B·exp(−σ))/∂σ.
    assert raised(replay, ray, values, 0.0, 2) == pytest.approx(-BEHIND[0] * np.exp(-sigma), rel=0.04)


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
