"""`ndf_path` against Mitsuba's `path`, `ndf_quadrature`, and closed forms of a ball's shell of constant
density."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from path_scenes import (
    BAND,
    FINE,
    FLOOR,
    RADIUS,
    SIGMA,
    T,
    assert_close,
    chord,
    diffuse,
    fan,
    glowing,
    grey,
    performer,
    radiance,
    scene_of,
)
from ridge_field import make_ridge

from ndf_mi.colour import srgb_to_linear


@pytest.fixture
def constant(make_constant_run):
    """Makes a run of constant density and colour in the ball's band."""
    # Densities have one limit, which is compiled into kernels.
    return lambda sigma=SIGMA, srgb=(0.5, 0.5, 0.5), name="run": make_constant_run(
        sigma, srgb, name=name, density_limit=max(16.0, 2 * sigma))


@pytest.mark.parametrize(("depth", "hide"),
                         [(1, False), (2, False), (7, False), (-1, False), (2, True), (7, True)])
def test_without_a_performer_it_is_mitsubas_path(depth, hide):
    """To rounding: the same numbers are drawn for the same decisions."""
    scene = mi.cornell_box()
    # With a box filter a path reaches one pixel alone, so that differing paths can be counted.
    scene["sensor"]["film"] |= {"width": 32, "height": 32, "rfilter": {"type": "box"}}
    scene["small-box"]["bsdf"] = {"type": "dielectric"}
    scene["large-box"]["bsdf"] = {"type": "roughconductor"}
    scene["back"] = {"type": "sphere", "radius": 0.2}
    scene |= {"sun": {"type": "directional", "direction": [1, -2, -1]},
              "sky": {"type": "constant", "radiance": grey(0.3)},
              "lamp": {"type": "point", "position": [0.5, 0, 0.5], "intensity": 0.3}}
    if hide:
        # Only the sky: what is behind a hidden area emitter, `path` sees along a ray moved sideways.
        del scene["light"]
    else:
        # Hiding emitters, `path` drops light that was scattered where a mask is then passed.
        scene["back"]["bsdf"] = {"type": "mask", "opacity": 0.5, "cover": {"type": "diffuse"}}
    integrators = [{"type": name, "max_depth": depth, "hide_emitters": hide} for name in ("path", "ndf_path")]
    images = [mi.render(mi.load_dict({**scene, "integrator": integrator}), spp=16, seed=3).numpy()
              for integrator in integrators]
    assert images[0].max() > 0.1
    # Rounding may send a path along another branch: how often depends on the processor.
    different = np.any(np.abs(images[0] - images[1]) > 1e-3, axis=-1)
    assert different.sum() <= 4 and abs(images[0].mean() - images[1].mean()) < 1e-3 * images[0].mean()


def test_hidden_emitters_are_gone_and_performers_before_them_are_not(constant):
    """The environment is black, not its light; what is behind an area emitter is where it is."""
    run = constant(srgb=(0.7, 0.4, 0.2))
    wall = {"wall": glowing(3.0, T().translate([0, 0, -1]).scale(3)),
            "behind": diffuse(0.5, T().translate([0, 0, -2]).scale(9))}
    for more, background in (({}, 1.0), (wall, None)):
        scene = scene_of(shapes={"performer": performer(run), **more}, background=background, max_depth=1,
                         samples=FINE, hide_emitters=True)
        o, d = fan()
        expected = (1 - np.exp(-SIGMA * chord(o, d)))[:, None] * srgb_to_linear(np.array((0.7, 0.4, 0.2)))
        assert_close(radiance(scene, o, d), expected)


@pytest.mark.parametrize("origin", [(0, 0, 2.0), (0.1, 0.05, 0.36), (0, 0, 0.1)],
                         ids=["outside", "in the band", "in the hollow"])
@pytest.mark.parametrize("stratified", [False, True])
def test_alone_a_performer_is_what_ndf_quadrature_shows(constant, stratified, origin):
    shapes = {"performer": performer(constant(srgb=(0.7, 0.4, 0.2)))}
    options = dict(samples=32, stratified=stratified, shapes=shapes, background=0.25, origin=origin,
                   aovs="depth,opacity")
    expected, image = (mi.render(scene_of(name, **options), spp=4, seed=1).numpy()
                       for name in ("ndf_quadrature", "ndf_path"))
    assert expected.std() > 0.01
    np.testing.assert_allclose(image, expected, atol=1e-5)


def test_a_field_that_varies_is_what_ndf_quadrature_shows(make_run):
    run = make_run(density_bias=0.0, density_gain=12.0)
    expected, image = (mi.render(scene_of(name, shapes={"performer": performer(run)}, background=0.25),
                                 spp=4).numpy()
                       for name in ("ndf_quadrature", "ndf_path"))
    np.testing.assert_allclose(image, expected, atol=1e-5)


def test_before_a_turned_environment_map_it_is_what_ndf_quadrature_shows(constant):
    """And what Mitsuba's `path` shows where no performer is."""
    y, x = np.mgrid[:32, :64] / np.array([32, 64])[:, None, None]
    picture = np.stack([0.2 + x, 1 + 0.8 * np.sin(2 * np.pi * x), 0.3 + 2 * y], -1).astype(np.float32)

    def light(angle):
        return {"type": "envmap", "bitmap": mi.Bitmap(picture),
                "to_world": T().rotate([0, 1, 0], angle).rotate([1, 0, 0], 40)}

    shapes = {"performer": performer(constant())}
    images = {name: mi.render(scene_of(name, shapes={**shapes, "light": light(110)}), spp=4, seed=1).numpy()
              for name in ("ndf_quadrature", "ndf_path")}
    np.testing.assert_allclose(images["ndf_path"], images["ndf_quadrature"], atol=1e-5)
    empty, other = (mi.render(scene_of("path", shapes={"light": light(angle)}), spp=4, seed=1).numpy()
                    for angle in (110, 0))
    corner = images["ndf_path"][:3, :3]
    np.testing.assert_allclose(corner, empty[:3, :3], atol=1e-5)
    assert np.abs(corner - other[:3, :3]).max() > 0.1 and np.abs(images["ndf_path"] - empty).max() > 0.1


@pytest.mark.parametrize("sampler", ["independent", "multijitter"])
def test_passes_have_the_mean_of_one(constant, monkeypatch, sampler):
    from ndf_mi.plugins import ndf_path

    shapes = {"performer": performer(constant()),
              "floor": diffuse(0.5, T().translate([0, -0.5, 0]).rotate([1, 0, 0], -90))}
    scene = scene_of(size=8, shapes=shapes, background=1.0, sampler=sampler, samples=32, aovs="opacity")
    whole = mi.render(scene, spp=64).numpy()
    monkeypatch.setattr(ndf_path, "PATHS_AT_ONCE", 8 * 8 * 20)
    parts = mi.render(scene, spp=64).numpy()
    assert parts.shape == whole.shape and not np.array_equal(parts, whole) or sampler == "multijitter"
    np.testing.assert_allclose(parts.mean((0, 1)), whole.mean((0, 1)), rtol=0.02)
    np.testing.assert_allclose(np.array(scene.sensors()[0].film().bitmap())[..., 0], parts[..., 0], rtol=1e-5)


# Surfaces and segments.


@pytest.mark.parametrize("z", [-1.0, 0.6, 0.0, 0.33],
                         ids=["behind", "before", "through the middle", "through the band"])
def test_surfaces_hide_and_are_hidden(constant, z):
    srgb = (0.7, 0.4, 0.2)
    wall = glowing(2.0, T().translate([0, 0, z]).scale(3))
    scene = scene_of(shapes={"performer": performer(constant(srgb=srgb)), "wall": wall}, samples=FINE,
                     max_depth=1)
    o, d = fan()
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    transmittance = np.exp(-SIGMA * chord(o, d, end=(z - 2.0) / unit[:, 2]))[:, None]
    expected = (1 - transmittance) * srgb_to_linear(np.array(srgb)) + 2.0 * transmittance
    assert_close(radiance(scene, o, d), expected)


def test_a_mirror_shows_what_the_mirrored_camera_sees(make_run):
    run = make_run(density_bias=0.0, density_gain=12.0)
    mirror = {"type": "rectangle", "to_world": T().translate([-0.8, 0, 0]).rotate([0, 1, 0], 90).scale(2),
              "bsdf": {"type": "conductor", "material": "none"}}
    both = scene_of(shapes={"performer": performer(run), "mirror": mirror}, background=0.3, max_depth=2,
                    samples=FINE)
    alone = scene_of(shapes={"performer": performer(run)}, background=0.3, samples=FINE)
    mirrored_o, mirrored_d = fan(origin=(-2.6, 0, 1.5), spread=0.12)
    flip = np.array([-1.0, 1, 1])
    o, d = mirrored_o * flip - [1.6, 0, 0], mirrored_d * flip
    assert (chord(o, d) == 0).all()
    seen, expected = radiance(both, o, d), radiance(alone, mirrored_o, mirrored_d)
    assert expected.std() > 0.02
    np.testing.assert_allclose(seen, expected, atol=1e-3)


def test_glass_without_refraction_changes_nothing(constant):
    """Delta lobes end segments and begin others: inside a sphere of refractive index 1 everything is as
    without it."""
    run = constant(srgb=(0.7, 0.4, 0.2))
    without = radiance(scene_of(shapes={"performer": performer(run)}, background=0.3, samples=FINE), *fan())
    for radius in (0.8, 0.3):
        glass = {"type": "sphere", "radius": radius,
                 "bsdf": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.0}}
        scene = scene_of(shapes={"performer": performer(run), "glass": glass}, background=0.3, samples=FINE)
        assert_close(radiance(scene, *fan()), without)


# Light.


def floor_points(n=150):
    rng = np.random.default_rng(5)
    points = np.stack([rng.uniform(-0.7, 0.7, n), np.full(n, -0.5), rng.uniform(-0.7, 0.7, n)], 1)
    return points, points + [0, 0.05, 0], np.repeat([[0.0, -1.0, 0.0]], n, 0)




@pytest.mark.parametrize("light", ["directional", "point"])
def test_shadows_on_a_floor_are_the_transmittance_to_the_light(constant, light):
    reflectance = 0.6
    run = constant(srgb=(1e-6,) * 3)
    at, towards = np.array([0.3, 1.2, -0.2]), np.array([0.4, 1.0, 0.2]) / np.linalg.norm([0.4, 1.0, 0.2])
    emitter = ({"type": "directional", "direction": list(-towards), "irradiance": grey(3.0)}
               if light == "directional"
               else {"type": "point", "position": list(at), "intensity": grey(3.0)})
    shapes = {"performer": performer(run), "floor": diffuse(reflectance, FLOOR), "light": emitter}
    scene = scene_of(shapes=shapes, max_depth=2, samples=FINE)
    points, o, d = floor_points()
    w = np.repeat(towards[None], len(points), 0) if light == "directional" else at - points
    distance = np.linalg.norm(w, axis=1)
    power = 3.0 if light == "directional" else 3.0 / distance**2
    irradiance = power * (w[:, 1] / distance) * np.exp(-SIGMA * chord(points, w))
    # 5 cm of way to the floor, beside the band.
    expected = reflectance / np.pi * irradiance * np.exp(-SIGMA * chord(o, d, end=0.05))
    seen = radiance(scene, o, d)
    assert expected.min() < 0.5 * expected.max()
    assert_close(seen / expected.max(), expected[:, None] / expected.max())


@pytest.mark.parametrize("light", ["constant", "area", "rough"])
def test_in_a_furnace_everything_is_as_bright(constant, light):
    """A performer that emits radiance 1, in surroundings that do: whatever is emitted, absorbed, sampled
    either way or
    scattered by a floor, which sees no part of itself, adds up to reflectance times 1."""
    run = constant(srgb=(0.99999,) * 3)
    if light == "area":
        # From within, a sphere that emits: an area emitter, met by chance and sampled.
        surroundings = {"type": "sphere", "radius": 5.0, "flip_normals": True,
                        "bsdf": {"type": "diffuse", "reflectance": grey(0.0)},
                        "emitter": {"type": "area", "radiance": grey(1.0)}}
    else:
        surroundings = {"type": "constant", "radiance": grey(1.0)}
    floor = diffuse(0.6, FLOOR)
    if light == "rough":
        floor["bsdf"]["b"] = {"type": "blendbsdf", "weight": 0.5,
                              "a": {"type": "diffuse", "reflectance": grey(0.6)},
                              "b": {"type": "diffuse", "reflectance": grey(0.6)}}
    scene = scene_of(shapes={"performer": performer(run), "floor": floor, "surroundings": surroundings},
                     max_depth=2, samples=32)
    points, o, d = floor_points(40)
    seen = radiance(scene, o, d, spp=256)
    transmittance = np.exp(-SIGMA * chord(o, d, end=0.05))[:, None]
    expected = 0.6 * transmittance + (1 - transmittance)
    np.testing.assert_allclose(seen.mean(0), expected.mean(), rtol=5e-3)
    assert np.abs(seen - expected).max() < 0.06


def test_a_performers_light_on_a_floor(constant):
    """An opaque ball of radiance 1 gives the irradiance π (R/h)² cos θ of a sphere wholly above the horizon.
    """
    run = constant(400.0, (0.99999,) * 3)
    scene = scene_of(shapes={"performer": performer(run), "floor": diffuse(0.5, FLOOR)}, max_depth=2,
                     samples=32)
    points, o, d = floor_points(12)
    seen = radiance(scene, o, d, spp=1024)[:, 0]
    distance = np.linalg.norm(points, axis=1)
    expected = 0.5 * ((RADIUS + BAND) / distance) ** 2 * (0.5 / distance)
    np.testing.assert_allclose(seen.mean(), expected.mean(), rtol=0.03)
    np.testing.assert_allclose(seen, expected, atol=0.03)


# Several performers.


def placed(run, shift):
    """The run with its performer elsewhere: nothing of a field but its colours' directions and normals is of
    the world."""
    run.poses.vertices[:] += np.asarray(shift, np.float32)
    run.save()
    return run


@pytest.mark.parametrize("shift", [(0.2, 0, -1.0), (-0.1, 0, 1.0), (0.1, 0.05, -0.2)],
                         ids=["behind", "before", "overlapping"])
def test_two_performers(constant, shift):
    """In whichever order the scene names them, against a sum in float64."""
    srgb, densities, centres = [(0.9, 0.3, 0.1), (0.1, 0.3, 0.9)], (5.0, 8.0), (np.zeros(3), np.array(shift))
    first, second = (placed(constant(density, c, name=f"run{density}"), centre)
                     for density, c, centre in zip(densities, srgb, centres, strict=True))
    o, d = fan(150, origin=(0, 0, 3.0), spread=0.12)
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    nodes = np.linspace(0, 6, 4001)
    x = o[:, None] + unit[:, None] * ((nodes[1:] + nodes[:-1]) / 2)[None, :, None]
    sigma = np.stack([s * (np.abs(np.linalg.norm(x - c, axis=-1) - RADIUS) < BAND)
                      for s, c in zip(densities, centres, strict=True)], -1)
    tau = np.cumsum(sigma.sum(-1) * np.diff(nodes), 1)
    through = np.exp(-np.concatenate([np.zeros((len(o), 1)), tau], 1))
    share = (through[:, :-1] - through[:, 1:])[..., None] * sigma / np.maximum(sigma.sum(-1, keepdims=True),
                                                                               1e-9)
    expected = share.sum(1) @ srgb_to_linear(np.array(srgb)) + 0.2 * through[:, -1:]
    for shapes in ({"a": performer(first), "b": performer(second)},
                   {"b": performer(second), "a": performer(first)}):
        assert_close(radiance(scene_of(shapes=shapes, background=0.2, samples=FINE), o, d), expected)


def test_one_performer_in_several_shapes_counts_once(constant):
    run = constant()
    again = {"type": "ndf", "run": str(run.path / ".." / run.path.name)}
    inner = {"type": "sphere", "radius": 0.25, "bsdf": {"type": "null"}, "interior": again, "exterior": again}
    one, two, three = (mi.render(scene_of(shapes={"outer": performer(run), **more}, background=1.0,
                                          samples=32), spp=4).numpy()
                       for more in ({}, {"inner": inner}, {"other": performer(run, frame=1)}))
    np.testing.assert_allclose(one, two, atol=1e-6)
    # Another frame is another performer.
    assert np.abs(one - three).max() > 0.05


def test_layers_of_nested_shells_are_one_performer(make_run):
    shell = performer(make_ridge(make_run, srgb=(0.9, 0.5, 0.2))[0])
    plain, nested = (scene_of(shapes={"p": {**shell, **more}}, background=0.5, samples=32)
                     for more in ({}, {"layers": 4, "cell": 0.02}))
    assert len(nested.shapes()) > 1
    np.testing.assert_allclose(mi.render(nested, spp=4).numpy(), mi.render(plain, spp=4).numpy(), atol=1e-5)


def test_the_scale_of_a_medium_is_a_factor_on_its_density(constant):
    single, double = (constant(sigma, name=f"run{sigma}") for sigma in (4.0, 8.0))
    scaled, plain = (radiance(scene_of(shapes={"a": performer(run, scale=scale)}, background=1.0,
                                       samples=FINE), *fan())
                     for run, scale in ((single, 2.0), (double, 1.0)))
    np.testing.assert_allclose(scaled, plain, atol=1e-3)


# Cost.


def test_nothing_is_compiled_anew_and_what_misses_is_not_evaluated(constant):
    run = constant()
    shapes = {"performer": performer(run), "floor": diffuse(0.5, FLOOR),
              "lamp": {"type": "point", "position": [1, 2, 1]}}
    scene = scene_of(shapes=shapes, background=0.2, max_depth=5, samples=32)
    for seed in range(2):
        mi.render(scene, spp=4, seed=seed)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        mi.render(scene, spp=4, seed=9)
        assert sum(not kernel["cache_hit"] for kernel in dr.kernel_history([dr.KernelType.JIT])) == 0
    away = scene_of(shapes={"performer": performer(run)}, background=0.2, origin=(0, 0, 2.0))
    assert radiance(away, [[0.0, 0, 2]], [[0.0, 0, 1]]) == pytest.approx(0.2)
    assert away.integrator().transport.evaluated == 0


# Gradients.
