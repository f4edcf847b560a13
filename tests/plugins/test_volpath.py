"""The medium in nested shells under Mitsuba's own integrators: means against closed forms, Mitsuba's grid
medium and the quadrature.

Means of several independent renders are compared within four standard errors of their difference, plus the
stated tolerance.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from field_scenes import BAND, RADIUS, SIZE, performer, scene_of, sensor
from ridge_field import make_ridge, peak_of

from ndf_mi.errors import InputError
from ndf_mi.render.scene_issues import scene_issues
from ndf_mi.variants import cooperative_precisions

INTEGRATORS = ["volpath", "volpathmis", "prbvolpath"]
ERRORS = 4


def media(scene):
    return {shape.id(): shape.interior_medium() for shape in scene.shapes()
            if shape.interior_medium() is not None}


@pytest.fixture
def four_shells(monkeypatch):
    """As many shells as that, whether they pay or not."""
    monkeypatch.setattr("ndf_mi.render.nested.best_levels", lambda estimate, count: (0.5, 4.0, 12.0))


def means(scene, spp=128, count=6):
    """Means over the image of independent renders, (count, 3)."""
    return np.array([mi.render(scene, spp=spp, seed=seed).numpy().mean((0, 1)) for seed in range(count)],
                    dtype=np.float64)


def agree(a, b, also=0.0, small=0.01):
    """Whether two sets of means agree within `ERRORS` standard errors, a fraction `small` of the second at
    most each, and a fraction
    `also` of it."""
    noise = np.sqrt(sum(m.var(0, ddof=1) / len(m) for m in (a, b) if len(m) > 1))
    difference = np.abs(a.mean(0) - b.mean(0))
    assert (difference < ERRORS * noise + also * b.mean(0)).all(), (difference, noise)
    # The comparison means something: the noise is small itself.
    assert (noise < small * b.mean(0)).all(), noise / b.mean(0)


def through(density, fov=28, distance=2.0, size=SIZE, fine=32):
    """The image's mean transmittance through the ball's band, by float64 sums along a fine grid of rays."""
    at = np.tan(np.radians(fov) / 2) * (2 * (np.arange(size * fine) + 0.5) / (size * fine) - 1)
    x, y = np.meshgrid(at, at)
    offset = distance * np.sqrt(x**2 + y**2) / np.sqrt(1 + x**2 + y**2)
    closest, turn = np.unique(np.round(offset, 4), return_inverse=True)
    step = 2e-4
    s = np.arange(0, RADIUS + BAND, step) + step / 2
    sigma = density(np.sqrt(closest[:, None] ** 2 + s**2) - RADIUS)
    return float(np.exp(-2 * step * sigma.sum(1))[turn].mean())


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_transmittance_agrees_with_the_closed_form(make_run, four_shells, integrator):
    run, density = make_ridge(make_run, peak=-1.5)
    scene = scene_of({"performer": performer(run)}, integrator)
    found = media(scene)
    assert sorted(found) == ["performer", "performer_1", "performer_2", "performer_3"]
    values = [float(found[name].majorant[0]) for name in sorted(found)]
    assert values == sorted(values) and values[0] < 0.05 * values[-1] < 0.05 * 1.05 * 200
    # The ball is a mesh, up to 1.5 mm within the sphere.
    agree(means(scene), np.full((1, 3), through(density)), also=2e-3)


def test_transmittance_of_a_constant_density(make_constant_run):
    run = make_constant_run(6.0, srgb=(1e-6,) * 3)
    scene = scene_of({"performer": performer(run, layers=4)})
    (medium,) = media(scene).values()
    assert 1.05 * 6 < float(medium.majorant[0]) < 1.3 * 6
    agree(means(scene), np.full((1, 3), through(lambda l: np.where(np.abs(l) < BAND, 6.0, 0))), also=2e-3)


def test_transmittance_agrees_with_the_quadrature_in_the_same_shells(make_run, four_shells):
    run, _ = make_ridge(make_run, peak=-1.5)
    shapes = {"performer": performer(run)}
    agree(means(scene_of(shapes)), means(scene_of(shapes, "ndf_quadrature", samples=400), spp=64, count=3),
          also=5e-4)


def baked(run, frame, cells=72):
    """The field of a frame as Mitsuba's grid medium in a cube around it."""
    half = RADIUS + BAND + 0.01
    posed = run.posed(frame)
    centre = run.poses.translation[run.poses.index(frame)].astype(np.float64)
    at = (np.arange(cells) + 0.5) / cells * 2 * half - half
    z, y, x = np.meshgrid(at, at, at, indexing="ij")
    points = mi.Point3f(*(np.ascontiguousarray(v.ravel() + c, dtype=np.float32)
                          for v, c in zip((x, y, z), centre, strict=True)))
    posed.bound.pack()
    sample = posed.fused(points, mi.Vector3f(0, 0, 1))
    sigma = sample.sigma.numpy().reshape(cells, cells, cells, 1)
    albedo = np.moveaxis(sample.colour.numpy(), 0, -1).reshape(cells, cells, cells, 3)
    box = mi.ScalarTransform4f().translate(centre.tolist()).scale(2 * half).translate([-0.5, -0.5, -0.5])
    volumes = {name: {"type": "gridvolume",
                      "grid": mi.VolumeGrid(np.ascontiguousarray(grid, dtype=np.float32)), "to_world": box}
               for name, grid in (("sigma_t", sigma), ("albedo", albedo))}
    return half, centre, {"type": "heterogeneous", **volumes}


@pytest.fixture
def wide(make_run):
    """A run whose frames are 5 cm apart; a ridge wide enough for the grid, of a colour that nothing changes.
    """
    return make_ridge(make_run, peak=-0.5, slope=12.0, low=0.015, high=0.03, srgb=(0.95, 0.8, 0.5),
                      frames=20)[0]


@pytest.mark.parametrize("integrator", ["volpath", "prbvolpath"])
def test_two_performers_agree_with_mitsubas_grid_medium(wide, four_shells, integrator):
    """Also with a phase function, and shells within shells in different media."""
    hg = {"type": "hg", "g": 0.6}
    camera = sensor((0.45, 0, 3.0), (0.45, 0, 0))
    two, grids = {}, {}
    for frame in (0, 18):
        two[f"performer{frame}"] = performer(wide, frame=frame, phase=hg)
        half, centre, medium = baked(wide, frame)
        grids[f"cube{frame}"] = {"type": "cube",
                                 "to_world": mi.ScalarTransform4f().translate(centre.tolist()).scale(half),
                                 "bsdf": {"type": "null"}, "interior": {**medium, "phase": hg}}
    # The light is uneven, so that the phase function matters.
    light = {"sun": {"type": "directional", "direction": [0.3, -0.5, -1], "irradiance": 3.0}}
    ours, theirs = (scene_of({**shapes, **light}, integrator, camera, depth=5) for shapes in (two, grids))
    assert len(media(ours)) == 8
    # What a grid of 72 cells blurs.
    agree(means(ours), means(theirs), also=8e-3)


@pytest.mark.parametrize("integrator", ["volpath", pytest.param("volpathmis", marks=pytest.mark.long)])
def test_camera_inside_the_medium_agrees_with_mitsubas_grid_medium(wide, four_shells, integrator):
    camera = {"origin": (0, 0, RADIUS + 0.02), "target": (1, 0.3, RADIUS), "fov": 60}
    ref = {"type": "ref", "id": "medium"}
    half, _, medium = baked(wide, 0)
    cube = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(half), "bsdf": {"type": "null"},
            "interior": ref}
    shell = {"type": "ndf_shell", "layers": 3, "cell": 0.0125, "interior": ref}
    field = {"type": "ndf", "run": str(wide.path), "frame": 0}
    ours, theirs = (scene_of({"medium": what, "performer": shape}, integrator, sensor(**camera, medium=ref),
                             depth=5)
                    for what, shape in ((field, shell), (medium, cube)))
    assert not scene_issues(ours)
    agree(means(ours), means(theirs), also=8e-3)


WIDE = 24
LAMP = np.array([1.1, 1.0, -1.0])
MIRROR = {"type": "rectangle", "bsdf": {"type": "conductor"},
          "to_world": mi.ScalarTransform4f().look_at([-0.75, 0, -0.35], [0.3, 0.1, 0.9],
                                                     [0, 1, 0]).scale([0.45, 0.5, 1])}


def room():
    """A floor under the ball, a mirror next to it, a lamp above and a dim sky; white, so that light bounces
    between them."""
    place = mi.ScalarTransform4f()
    return {
        "floor": {"type": "rectangle",
                  "to_world": place.translate([0, -0.4, 0]).rotate([1, 0, 0], -90).scale(3),
                  "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}}},
        "mirror": MIRROR,
        "lamp": {"type": "rectangle",
                 "to_world": place.look_at(LAMP.tolist(), [0, 0, 0], [0, 1, 0]).scale(0.35),
                 "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 10.0}}},
        "light": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}},
    }


def passes(o, d):
    """How far from the origin rays pass."""
    d = d / np.linalg.norm(d, axis=-1, keepdims=True)
    return np.linalg.norm(o - np.minimum((o * d).sum(-1, keepdims=True), 0) * d, axis=-1)


def regions(camera):
    """Which pixels show the performer, its image in the mirror, its shadow on the floor, and the floor far
    from it; each (h, w) bool."""
    scene = scene_of(room(), camera=camera)
    y, x = (np.mgrid[:WIDE, :WIDE].reshape(2, -1) + 0.5) / WIDE
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.0, mi.Point2f(x.astype(np.float32), y.astype(np.float32)),
                                           mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    shapes = {shape.id(): mi.ShapePtr(shape) for shape in scene.shapes()}
    floor, mirror = ((si.shape == shapes[name]).numpy() for name in ("floor", "mirror"))
    o, d, p, n = (np.broadcast_to(np.array(v, dtype=np.float64).reshape(3, -1), (3, WIDE**2)).T
                  for v in (ray.o, ray.d, si.p, si.n))
    seen = passes(o, d)
    shadow = passes(p, LAMP - p)
    found = {"performer": seen < 0.33,
             "mirrored": mirror & (passes(p, d - 2 * (d * n).sum(-1, keepdims=True) * n) < 0.3),
             "shadow": floor & (seen > 0.45) & (shadow < 0.25),
             "floor": floor & (seen > 0.45) & (shadow > 0.6)}
    return {name: mask.reshape(WIDE, WIDE) for name, mask in found.items()}


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["volpath", "volpathmis"])
def test_among_surfaces_it_agrees_with_mitsubas_grid_medium(wide, four_shells, integrator):
    """What it throws on a floor, shows in a mirror and scatters of a lamp's light: region by region of the
    image."""
    camera = sensor((0.55, 0.5, 2.6), (-0.15, -0.1, 0), fov=42, size=WIDE)
    half, _, medium = baked(wide, 0)
    cube = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(half), "bsdf": {"type": "null"},
            "interior": medium}
    images = [np.array([mi.render(scene, spp=256, seed=seed).numpy() for seed in range(8)], dtype=np.float64)
              for scene in (scene_of({**room(), "performer": shape}, integrator, camera, depth=6)
                            for shape in (performer(wide), cube))]
    shown = regions(camera)
    ours, theirs = ({name: image[:, mask].mean(1) for name, mask in shown.items()} for image in images)
    for name, mask in shown.items():
        assert mask.sum() >= 8, name
        agree(ours[name], theirs[name], also=0.01, small=0.02)
    assert theirs["shadow"].mean() < 0.6 * theirs["floor"].mean()


@pytest.mark.parametrize("integrator",
                         ["volpath", *(pytest.param(name, marks=pytest.mark.long)
                                       for name in INTEGRATORS[1:])])
def test_in_a_furnace_what_absorbs_nothing_is_not_seen(make_constant_run, four_shells, integrator):
    """Albedo 1 up to rounding: however often light scatters, the same amount leaves as enters."""
    run = make_constant_run(15.0, srgb=(0.99999,) * 3)
    image = np.mean([mi.render(scene_of({"performer": performer(run)}, integrator, depth=-1), spp=128,
                               seed=seed).numpy()
                     for seed in range(4)], axis=0)
    assert image.mean() == pytest.approx(1, abs=5e-3)
    assert np.abs(image - 1).max() < 0.1


def test_gradient_under_prbvolpath_agrees_with_the_closed_form(make_run):
    """∂(mean transmittance)/∂peak, by the majorants of training."""
    run, density = make_ridge(make_run, peak=-1.5, density_limit=60.0)
    scene = scene_of({"performer": performer(run)}, "prbvolpath")
    params = mi.traverse(scene)
    key = "performer.interior_medium.weights"
    dr.enable_grad(params[key])
    params.update()
    assert all(float(medium.majorant[0]) == pytest.approx(63.0) for medium in media(scene).values())
    # In half precision, all that GPUs have, sums of more than some thousand paths stall.
    passes = 1 if "single" in cooperative_precisions() else 16
    gradients = []
    for seed in range(4):
        found = []
        for part in range(passes):
            dr.set_grad(params[key], 0)
            one = 2 * (seed * passes + part)
            image = mi.render(scene, params, spp=16, spp_grad=128 // passes, seed=one, seed_grad=one + 1)
            dr.backward(dr.mean(image, axis=None))
            found.append(dr.grad(params[key]).numpy()[peak_of(run)])
        gradients.append(np.mean(found))
    gradients = np.array(gradients, dtype=np.float64)
    step = 0.02
    around = [through(make_ridge(make_run, "other", peak=-1.5 + sign * step, density_limit=60.0)[1])
              for sign in (1, -1)]
    expected = (around[0] - around[1]) / (2 * step)
    assert expected < -0.02
    error = gradients.std(ddof=1) / np.sqrt(len(gradients))
    assert error < 0.1 * abs(expected)
    assert abs(gradients.mean() - expected) < ERRORS * error + 0.01 * abs(expected)


def test_xml_of_a_file(make_run, four_shells, tmp_path):
    run, _ = make_ridge(make_run)
    (tmp_path / "scene.xml").write_text(f"""<scene version="3.5.0">
        <integrator type="volpath"/> <emitter type="constant"/>
        <sensor type="perspective"><transform name="to_world">
            <lookat origin="0,0,2" target="0,0,0" up="0,1,0"/></transform></sensor>
        <shape type="ndf_shell" id="performer">
            <integer name="layers" value="3"/>
            <medium type="ndf" name="interior"><string name="run" value="{run.path}"/></medium>
        </shape></scene>""")
    scene = mi.load_file(str(tmp_path / "scene.xml"))
    assert sorted(media(scene)) == ["performer", "performer_1", "performer_2", "performer_3"]
    # Between two shells it is one and the same medium, whichever shell it is reached through.
    shells = {shape.id(): shape for shape in scene.shapes()}
    assert shells["performer"].exterior_medium() is None
    for outer, inner in (("performer", "performer_1"), ("performer_1", "performer_2"),
                         ("performer_2", "performer_3")):
        assert shells[inner].exterior_medium() is shells[outer].interior_medium()
    keys = mi.traverse(scene).keys()
    assert [key for key in keys if key.endswith(".weights")] == ["performer.interior_medium.weights"]


def test_majorants_follow_the_parameters(make_run, capfd):
    run, density = make_ridge(make_run, density_limit=100.0)
    scene = scene_of({"performer": performer(run)})
    found = [media(scene)[name] for name in sorted(media(scene))]
    assert len(found) > 1
    params = mi.traverse(scene)
    key = "performer.interior_medium.weights"
    before = [float(medium.majorant[0]) for medium in found]
    weights = params[key].numpy()
    weights[peak_of(run)] += 1
    params[key] = mi.Float(weights)
    params.update()
    after = [float(medium.majorant[0]) for medium in found]
    top = make_ridge(make_run, "denser", peak=2.0, density_limit=100.0)[1](np.array(0.015))
    assert all(b > a for a, b in zip(before, after, strict=True)) and top < after[-1] <= 105.001
    dr.enable_grad(params[key])
    params[key] = params[key] * 1
    params.update()
    assert [float(medium.majorant[0]) for medium in found] == pytest.approx([105.0] * len(found))
    assert "ndf:" not in capfd.readouterr().out


def said(capfd):
    out, err = capfd.readouterr()
    return out + err


def test_a_moved_body_warns_once(make_run, capfd):
    run, _ = make_ridge(make_run)
    params = mi.traverse(scene_of({"performer": performer(run)}))
    for shift in (0.05, 0.06):
        params["performer.interior_medium.vertices"] = mi.Float((run.poses.vertices[0]
                                                                 + np.float32([shift, 0, 0])).ravel())
        params.update()
    text = said(capfd)
    assert text.count("the body has moved") == 1 and "load the scene again" in text and str(run.path) in text


def test_a_density_above_its_majorant_warns_with_place_and_repair(make_run, capfd):
    run, _ = make_ridge(make_run, peak=2.0, slope=3000.0, low=0.03, high=0.0302)
    scene_of({"performer": performer(run, cell=0.06)})
    text = said(capfd)
    assert text.count("per metre, above the majorant") == 1
    for word in ("the density at (", "`cell`", "`layers`", str(run.path)):
        assert word in text


@pytest.mark.parametrize(("change", "words"), [
    ({"layers": -1}, ["layers", "-1"]),
    ({"layers": 99}, ["layers", "99"]),
    ({"cell": 0.0}, ["cell", "0"]),
    ({"frame": 2}, ["interior", "frame 0", "frame 2"]),
    ({"interior": {"type": "homogeneous"}}, ["run", "nothing"]),
    ({"to_world": mi.ScalarTransform4f().scale(2)}, ["to_world", "offset"]),
    ({"flip_normals": True}, ["flip_normals", "outward"]),
    ({"flip_normals": True, "layers": 0}, ["flip_normals", "outward"]),
    ({"offset": [1, 0, 0]}, ["interior", "offset", "1.0"]),
])
def test_wrong_parameters_of_the_shell_are_named(make_run, change, words):
    run = make_run()
    with pytest.raises(Exception) as caught:
        mi.load_dict({**performer(run), **change})
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("layers", [0, 3])
def test_an_offset_moves_performer_and_shell(make_run, layers):
    """The same rays, moved with the performer, see the same: the shells lie where they lay, and the camera
    too."""
    run, _ = make_ridge(make_run)
    place = np.array([0.5, -0.25, 1.0])
    pictures, bounds = [], []
    for offset in (np.zeros(3), place):
        shape = performer(run, layers)
        shape["interior"] = {**shape["interior"], "offset": offset.tolist()}
        camera = sensor(origin=tuple(np.array([0, 0, 2.0]) + offset), target=tuple(offset))
        scene = scene_of({"performer": shape}, camera=camera)
        bounds.append([np.array(corner).ravel() - offset for corner in (scene.bbox().min, scene.bbox().max)])
        pictures.append(means(scene, spp=64, count=4))
    np.testing.assert_allclose(bounds[0], bounds[1], atol=1e-5)
    agree(*pictures)


@pytest.mark.parametrize(("change", "offset", "word"), [
    ({}, [float("nan"), 0, 0], "finite"),
    ({"coordinates": "world", "normal_octaves": -1}, [1, 0, 0], "world coordinates"),
])
def test_an_offset_that_cannot_be_is_refused(make_run, change, offset, word):
    with pytest.raises(RuntimeError, match=word):
        mi.load_dict({"type": "ndf", "run": str(make_run(**change).path), "offset": offset})


def test_one_medium_in_two_nests_is_refused(make_run):
    medium = mi.load_dict({"type": "ndf", "run": str(make_run().path)})
    medium.nest(2, 0.06)
    with pytest.raises(InputError, match="another `ndf_shell`"):
        medium.nest(2, 0.06)
