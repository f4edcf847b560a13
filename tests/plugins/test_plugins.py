"""The plugins in Mitsuba: against closed forms, Mitsuba's own grid medium, each other, and finite
differences."""

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi import variants
from ndf_mi.colour import srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.render.scene import render_scene

SCENES = Path(__file__).parents[2] / "scenes"
BAND, RADIUS = 0.08, 0.3


def scene_of(run, integrator="ndf_quadrature", background=1.0, size=24, shell=True, origin=(0, 0, 2.0),
             scale=1.0, **more):
    medium = {"type": "ndf", "run": str(run.path), "frame": 0, "scale": scale}
    shape = {"type": "ndf_shell", "run": str(run.path), "frame": 0} if shell else {
        "type": "cube", "to_world": mi.ScalarTransform4f().scale(RADIUS + BAND + 0.01)}
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": integrator, **more},
        "sensor": {
            "type": "perspective", "fov": 28,
            "to_world": mi.ScalarTransform4f().look_at(list(origin), [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"},
                     "pixel_format": "rgb"},
            "sampler": {"type": "independent"},
        },
        "light": {"type": "constant", "radiance": {"type": "rgb", "value": background}},
        "performer": {**shape, "bsdf": {"type": "null"}, "interior": medium},
    })


def chord(distance):
    """Length of a ray's way through the band, at this distance from the ball's centre."""
    outer = 2 * np.sqrt(np.maximum((RADIUS + BAND) ** 2 - distance**2, 0))
    return outer - 2 * np.sqrt(np.maximum((RADIUS - BAND) ** 2 - distance**2, 0))


def pixel_distances(scene, size):
    """Distances of the pixels' centre rays from the origin."""
    y, x = np.mgrid[:size, :size].astype(np.float32)
    ray, _ = scene.sensors()[0].sample_ray(0, 0,
                                           mi.Point2f(((x.ravel() + 0.5) / size), ((y.ravel() + 0.5) / size)),
                                           mi.Point2f(0.5))
    o, d = np.array(ray.o).reshape(3, -1), np.array(ray.d)
    return np.linalg.norm(np.cross(o, d, axis=0) if o.shape[1] > 1
                          else np.cross(o.repeat(size * size, 1), d, axis=0), axis=0)


def test_volpath_agrees_with_the_closed_form_of_absorption(make_constant_run):
    sigma, size = 6.0, 16
    run = make_constant_run(sigma, srgb=(1e-6,) * 3)
    scene = scene_of(run, "volpath", size=size, max_depth=8)
    images = np.stack([mi.render(scene, spp=256, seed=seed).numpy()[..., 0] for seed in range(4)])
    # Averaged over the pixel's area with a fine grid of rays.
    fine = pixel_distances(scene, size * 8).reshape(size, 8, size, 8)
    expected = np.exp(-sigma * chord(fine)).mean(axis=(1, 3))
    error = (images.mean() - expected.mean()) / expected.mean()
    assert abs(error) < 4e-3
    assert np.abs(images.mean(0) - expected).max() < 0.08


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_quadrature_agrees_with_the_closed_form_of_emission(make_constant_run, scale):
    sigma, size = 6.0, 24
    srgb = (0.7, 0.4, 0.2)
    run = make_constant_run(sigma / scale, srgb=srgb)
    scene = scene_of(run, size=size, samples=600, background=0.25, scale=scale)
    image = mi.render(scene, spp=64).numpy()
    fine = pixel_distances(scene, size * 8).reshape(size, 8, size, 8)
    transmittance = np.exp(-sigma * chord(fine)).mean(axis=(1, 3))
    expected = (1 - transmittance)[..., None] * srgb_to_linear(np.array(srgb))
    expected += 0.25 * transmittance[..., None]
    assert np.abs(image - expected).max() < 0.02
    assert np.abs(image - expected).mean() < 1e-3


def test_skipped_samples_change_no_more_than_their_transmittance(make_constant_run):
    scene = scene_of(make_constant_run(60.0), size=24, samples=200, background=0.25)
    cut = mi.load_dict({"type": "ndf_quadrature", "samples": 200, "min_transmittance": 0.02})
    whole, part = mi.render(scene, spp=4,
                            seed=1).numpy(), mi.render(scene, integrator=cut, spp=4, seed=1).numpy()
    assert 0 < np.abs(whole - part).max() < 0.02


@pytest.mark.parametrize("integrator", ["volpath", "volpathmis", "prbvolpath"])
def test_scattering_agrees_with_mitsubas_grid_medium(make_run, integrator):
    """The field's density and albedo, baked into a grid, give the same mean light within the noise."""
    run = make_run(density_bias=0.0, density_gain=12.0, density_limit=24.0, grid_finest=16)
    run.parameters = run.parameters.replace(grid=run.parameters.grid * 2e4)
    run.save()
    cells, half = 96, RADIUS + BAND + 0.01
    centres = (np.arange(cells) + 0.5) / cells * 2 * half - half
    z, y, x = np.meshgrid(centres, centres, centres, indexing="ij")
    points = mi.Point3f(x.ravel().astype(np.float32), y.ravel().astype(np.float32),
                        z.ravel().astype(np.float32))
    posed = run.posed(0)
    posed.bound.pack()
    # Albedo does depend on the direction; the grid's cannot: take it away by zeroing the direction's columns.
    field = run.model.field
    weights, layer = run.parameters.weights.numpy(), field.layers["colour0"]
    matrix = weights[layer.offset :][: layer.outputs * (layer.inputs + layer.pose)].reshape(layer.outputs, -1)
    matrix[:, field.preset.feature_width : layer.inputs] = 0
    run.parameters = run.parameters.replace(weights=mi.Float(weights))
    run.save()
    posed = run.posed(0)
    posed.bound.pack()
    sample = posed.fused(points, mi.Vector3f(0, 0, 1))
    sigma = sample.sigma.numpy().reshape(cells, cells, cells, 1)
    albedo = np.moveaxis(sample.colour.numpy(), 0, -1).reshape(cells, cells, cells, 3)
    assert sigma.max() > 5
    ours = scene_of(run, integrator, size=16, max_depth=16, rr_depth=64)
    to_world = mi.ScalarTransform4f().scale(2 * half).translate([-0.5, -0.5, -0.5])
    baked = mi.load_dict({
        "type": "scene", "integrator": {"type": integrator, "max_depth": 16, "rr_depth": 64},
        "light": {"type": "constant"},
        "sensor": {
            "type": "perspective", "fov": 28,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 2.0], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"},
                     "pixel_format": "rgb"},
            "sampler": {"type": "independent"},
        },
        "cube": {
            "type": "cube", "to_world": mi.ScalarTransform4f().scale(half), "bsdf": {"type": "null"},
            "interior": {
                "type": "heterogeneous", "scale": 1.0,
                "sigma_t": {"type": "gridvolume", "grid": mi.VolumeGrid(sigma.astype(np.float32)),
                            "to_world": to_world},
                "albedo": {"type": "gridvolume", "grid": mi.VolumeGrid(albedo.astype(np.float32)),
                           "to_world": to_world},
            },
        },
    })
    means = [np.array([mi.render(s, spp=64, seed=seed).numpy().mean((0, 1)) for seed in range(6)])
             for s in (ours, baked)]
    difference = means[0].mean(0) - means[1].mean(0)
    noise = np.sqrt(sum(m.var(0, ddof=1) / len(m) for m in means))
    # Three standard errors, and what a grid of 96 cells blurs.
    assert (np.abs(difference) < 3 * noise + 4e-3 * means[1].mean(0)).all(), (difference, noise)


def test_shell_and_cube_bound_the_same_medium(make_run):
    run = make_run(density_limit=20.0, density_gain=10.0)
    a, b = (mi.render(scene_of(run, "volpath", shell=shell, size=12, max_depth=6), spp=128).numpy().mean()
            for shell in (True, False))
    assert a == pytest.approx(b, rel=0.02)


@pytest.mark.skipif("single" not in variants.cooperative_precisions(),
                    reason="half precision is all that there is")
@pytest.mark.parametrize("integrator", ["volpath", pytest.param("prbvolpath", marks=pytest.mark.long)])
def test_a_medium_takes_half_precision_where_there_is_no_other(make_run, monkeypatch, capfd, integrator):
    """As on GPUs: the same picture but for the rounding, and gradients too, with a warning."""
    run = make_run(density_limit=20.0, density_gain=10.0)
    images, gradients, halves = [], [], []
    for precisions in (("single", "half"), ("half",)):
        monkeypatch.setattr("ndf_mi.variants.cooperative_precisions",
                            lambda precisions=precisions: precisions)
        scene = scene_of(run, integrator, size=8, max_depth=4)
        halves.append(scene.shapes()[0].interior_medium().posed().bound.half)
        if integrator == "volpath":
            images.append(mi.render(scene, spp=64).numpy())
            continue
        params = mi.traverse(scene)
        dr.enable_grad(params["performer.interior_medium.weights"])
        params.update()
        image = mi.render(scene, params, spp=16)
        dr.backward(dr.mean(image, axis=None))
        images.append(image.numpy())
        gradients.append(dr.grad(params["performer.interior_medium.weights"]).numpy())
        assert ("".join(capfd.readouterr()).count("summed in half precision")) == len(gradients) - 1
    assert halves == [False, True]
    # Paths part where rounding decides otherwise about a collision.
    assert images[0].mean() == pytest.approx(images[1].mean(), rel=0.01) and images[0].std() > 0.01
    if gradients:
        assert np.isfinite(gradients[1]).all()
        assert np.dot(*gradients) > 0.9 * np.linalg.norm(gradients[0]) * np.linalg.norm(gradients[1]) > 0


def test_fields_weights_are_parameters_and_train(make_run):
    """The loop of the README: Adam on the weights through mi.render brings the picture to a target."""
    # Rays fall anywhere in their pixels: enough of them, that the loss is not that of the silhouette's noise.
    target = mi.render(scene_of(make_run("target", seed=5, density_bias=0.0), size=12), spp=128).numpy()
    scene = scene_of(make_run("start", seed=1, density_bias=0.0), size=12)
    params = mi.traverse(scene)
    key = "performer.interior_medium.weights"
    opt = mi.ad.Adam(lr=1e-2)
    opt[key] = params[key]
    losses = []
    for step in range(25):
        params.update(opt)
        loss = dr.mean(dr.square(mi.render(scene, params, spp=32, seed=step) - mi.TensorXf(target)),
                       axis=None)
        dr.backward(loss)
        opt.step()
        losses.append(float(loss.array[0]))
    assert losses[-1] < 0.5 * losses[0]


@pytest.mark.parametrize("key", ["weights", "pose", "grid"])
def test_gradients_of_the_quadrature_agree_with_finite_differences(make_run, key):
    run = make_run(seed=3, density_bias=1.0, density_gain=10.0, grid_finest=16)
    run.parameters = run.parameters.replace(grid=run.parameters.grid * 5e3)
    run.save()
    # Gradients are taken along other rays than the picture: enough of both.
    scene = scene_of(run, size=16, samples=128, background=0.3)
    params = mi.traverse(scene)
    name = f"performer.interior_medium.{key}"
    start = params[name].numpy().astype(np.float64)
    rng = np.random.default_rng(7)
    # Uneven over the image, so that moving and scaling the body changes the sum.
    y, x = np.mgrid[:16, :16].astype(np.float32) / 16
    target = mi.TensorXf(np.stack([x, y, x * y], -1))

    def render(value, attached=False):
        params[name] = mi.Float(value.astype(np.float32))
        if attached:
            dr.enable_grad(params[name])
        params.update()
        return mi.render(scene, params, spp=64)

    image = render(start, attached=True)
    dr.backward(dr.sum(image * target, axis=None))
    gradient = dr.grad(params[name]).numpy().astype(np.float64)
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0
    size = {"weights": 3e-4, "grid": 1e-2, "pose": 1e-3}[key]
    for trial in range(3):
        direction = size * rng.uniform(0, 1, gradient.size) * np.sign(gradient)
        ahead, behind = ((render(start + sign * direction).numpy().astype(np.float64) * target.numpy()).sum()
                         for sign in (1, -1))
        assert (ahead - behind) / 2 == pytest.approx(float(gradient @ direction), rel=1e-2), trial


def test_aovs_have_names_and_values(make_constant_run):
    run = make_constant_run(300.0)
    scene = scene_of(run, size=16, samples=400, aovs="depth,opacity,uvl,normal")
    mi.render(scene, spp=1)
    bitmap = scene.sensors()[0].film().bitmap()
    names = [field.name for field in bitmap.struct_()]
    assert names[3:] == ["depth.T", "opacity.A", "uvl.U", "uvl.V", "uvl.L", "normal.X", "normal.Y",
                         "normal.Z"]
    values = dict(zip(names, np.moveaxis(np.array(bitmap), -1, 0), strict=True))
    assert values["opacity.A"][8, 8] > 0.99
    assert values["depth.T"][8, 8] == pytest.approx(2.0 - RADIUS - BAND, abs=0.02)
    assert values["uvl.L"][8, 8] == pytest.approx(BAND, abs=0.02)
    assert values["normal.Z"][8, 8] > 0.9


def test_shell_contains_the_band_and_is_closed(make_run):
    import trimesh

    from ndf_mi.render.shell import band_shell

    run = make_run()
    vertices, faces = band_shell(run.model.surface, mi.Float(run.poses.vertices[0].ravel()), BAND, 0.02)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.volume > 0
    radii = np.linalg.norm(vertices, axis=1)
    outer = radii > RADIUS
    assert radii[outer].min() > RADIUS + BAND and radii[outer].max() < RADIUS + BAND + 0.05
    assert radii[~outer].max() < RADIUS - BAND


@pytest.mark.parametrize(
    ("name", "change"),
    [(path.name, {}) for path in sorted(SCENES.glob("*.xml"))]
    + [("performer.xml", {"integrator": name}) for name in ("volpath", "volpathmis", "prbvolpath")],
)
def test_scenes_load_and_render(make_run, name, change):
    run = make_run(density_limit=20.0, density_gain=10.0)
    scene = mi.load_file(str(SCENES / name), run=str(run.path), width=16, height=16, origin="0, 0, 2",
                         target="0, 0, 0", **change)
    image = mi.render(scene, spp=4).numpy()
    assert np.isfinite(image).all() and image.std() > 0


@pytest.mark.parametrize(("change", "words"), [
    ({"frame": 77}, ["frame", "77", "0-2"]),
    ({"run": "nowhere"}, ["nowhere", "config.json"]),
    ({"scale": -1.0}, ["scale", "-1"]),
    ({"scale": float("inf")}, ["scale", "inf"]),
    ({"scale": float("nan")}, ["scale", "nan"]),
    ({"colour": 1.0}, ["colour"]),
])
def test_wrong_parameters_of_the_medium_are_named(make_run, change, words):
    run = make_run()
    with pytest.raises(Exception) as caught:
        mi.load_dict({"type": "ndf", "run": str(run.path), **change})
    for word in words:
        assert word in str(caught.value)


def test_wrong_parameters_of_the_integrator_are_named(make_run):
    for change, word in (({"aovs": "albedo"}, "albedo"), ({"samples": 0}, "samples"),
                         ({"min_transmittance": 1.0}, "min_transmittance"),
                         ({"sample": 3}, "sample")):
        with pytest.raises(Exception, match=word):
            mi.load_dict({"type": "ndf_quadrature", **change})
    empty = mi.load_dict({"type": "scene", "integrator": {"type": "ndf_quadrature"},
                          "sensor": {"type": "perspective"}})
    with pytest.raises(InputError, match="0 `ndf` media"):
        render_scene(empty)


@pytest.mark.parametrize("integrator", ["volpath", "ndf_path"])
def test_a_picture_in_which_half_precision_overflowed_is_refused(make_run, monkeypatch, integrator):
    """Under `ndf_path`, which takes no cooperative vectors, the same field is finite."""
    monkeypatch.setattr("ndf_mi.variants.cooperative_precisions", lambda: ("half",))
    monkeypatch.setattr("ndf_mi.variants.fused_width", lambda: 0)
    run = make_run()
    run.parameters = run.parameters.replace(weights=1e4 * run.parameters.weights)
    run.save()
    scene = scene_of(run, integrator, size=8, max_depth=3)
    if integrator == "volpath":
        with pytest.raises(InputError, match="NaN or infinity"):
            render_scene(scene, spp=4)
    else:
        channels, _ = render_scene(scene, spp=1)
        assert all(np.isfinite(channel).all() for channel in channels.values())
