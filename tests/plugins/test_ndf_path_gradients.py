"""Gradients through `ndf_path`, and what it refuses."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from path_scenes import FLOOR, T, diffuse, fan, performer, rays, scene_of

from ndf_mi.errors import InputError
from ndf_mi.render.scene import render_scene


@pytest.mark.parametrize("key", ["weights", "pose"])
def test_gradients_agree_with_finite_differences(make_run, key):
    """Through the direct view, a mirror and shadows, along fixed paths."""
    run = make_run(seed=3, density_bias=1.0, density_gain=10.0, grid_finest=16)
    run.parameters = run.parameters.replace(grid=run.parameters.grid * 5e3)
    run.save()
    mirror = {"type": "rectangle", "to_world": T().translate([-0.6, 0, 0]).rotate([0, 1, 0], 60).scale(2),
              "bsdf": {"type": "conductor", "material": "none"}}
    lamp = {"type": "point", "position": [0.2, 1, 0.5]}
    shapes = {"performer": performer(run), "mirror": mirror, "floor": diffuse(0.6, FLOOR), "lamp": lamp}
    # Roulette's decisions would depend on the density.
    scene = scene_of(shapes=shapes, background=0.3, samples=32, max_depth=3, rr_depth=9)
    params = mi.traverse(scene)
    name = f"performer.interior_medium.{key}"
    start = params[name].numpy().astype(np.float64)
    origins, directions = fan(600, spread=0.4)
    directions[:, 1] -= 0.1
    colour = mi.Color3f(np.random.default_rng(1).uniform(0, 1, (3, 600)).astype(np.float32))

    def value(at, mode=dr.ADMode.Primal):
        params[name] = mi.Float(at.astype(np.float32))
        if mode != dr.ADMode.Primal:
            dr.enable_grad(params[name])
        params.update()
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, 600)
        L = scene.integrator().sample(mode, scene, sampler, rays(origins, directions))[0]
        # In single precision, the rounding of the sum would be a few percent of the differences.
        return sum(dr.sum(mi.Float64(channel)) for channel in mi.Color3f(L) * colour)

    dr.backward(value(start, dr.ADMode.Backward))
    gradient = dr.grad(params[name]).numpy().astype(np.float64)
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0
    rng = np.random.default_rng(7)
    size = {"weights": 3e-4, "pose": 1e-3}[key]
    for _ in range(2):
        direction = size * rng.uniform(0, 1, gradient.size) * np.sign(gradient)
        ahead, behind = (float(value(start + sign * direction)[0]) for sign in (1, -1))
        assert (ahead - behind) / 2 == pytest.approx(float(gradient @ direction), rel=1e-2)


def test_training_through_mi_render_goes_down(make_run):
    aim, scene = (scene_of(shapes={"p": performer(make_run(name, seed=seed, density_bias=0.0))},
                           background=1.0, size=8, samples=32)
                  for name, seed in (("target", 5), ("start", 1)))
    target = mi.render(aim, spp=64).numpy()
    params = mi.traverse(scene)
    optimiser = mi.ad.Adam(lr=1e-2)
    optimiser["p.interior_medium.weights"] = params["p.interior_medium.weights"]
    losses = []
    for step in range(12):
        params.update(optimiser)
        loss = dr.mean(dr.square(mi.render(scene, params, spp=16, seed=step) - mi.TensorXf(target)),
                       axis=None)
        dr.backward(loss)
        optimiser.step()
        losses.append(float(loss.array[0]))
    assert losses[-1] < 0.8 * losses[0]


def test_gradients_of_anything_else_are_refused(make_run):
    scene = scene_of(shapes={"p": performer(make_run()), "floor": diffuse(0.5, FLOOR)}, background=1.0,
                     size=4, samples=16)
    params = mi.traverse(scene)
    key = "floor.bsdf.brdf_0.reflectance.value"
    dr.enable_grad(params[key])
    params.update()
    with pytest.raises(InputError, match="reflectance"):
        dr.backward(dr.sum(mi.render(scene, params, spp=1), axis=None))


# Users' mistakes.


@pytest.mark.parametrize(("change", "words"), [
    ({"max_depth": 0}, "max_depth"), ({"max_depth": -2}, "max_depth"), ({"rr_depth": 0}, "rr_depth"),
    ({"samples": 0}, "samples"),
    ({"aovs": "albedo"}, "depth, opacity"), ({"sample": 3}, "sample"),
])
def test_wrong_options_are_named(change, words):
    with pytest.raises(Exception, match=words):
        mi.load_dict({"type": "ndf_path", **change})


def test_other_media_are_refused(make_run):
    fog = {"type": "cube", "bsdf": {"type": "null"}, "interior": {"type": "homogeneous", "sigma_t": 1.0}}
    with pytest.raises(InputError, match="the shape 'fog'.*omogeneous"):
        render_scene(scene_of(shapes={"performer": performer(make_run()), "fog": fog}, background=1.0,
                              size=4))


def test_a_shell_that_lets_nothing_through_is_refused(make_run):
    with pytest.raises(InputError, match="the shape 'performer'.*null"):
        render_scene(scene_of(shapes={"performer": performer(make_run(), bsdf="diffuse")}, background=1.0,
                              size=4))
