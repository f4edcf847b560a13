"""A field on a sparse grid, against scipy's interpolation on the same nodes and a density known in closed
form."""

import dataclasses
import gc

import drjit as dr
import igl
import mitsuba as mi
import numpy as np
import pytest
from ridge_field import make_ridge
from scipy.interpolate import RegularGridInterpolator

from ndf_mi.errors import InputError
from ndf_mi.render import sparse_grid
from ndf_mi.render.sparse_grid import SIDE, SparseGrid

CELL = 0.01


def blocked(run, cell=CELL):
    preset = run.model.field.preset
    vertices = mi.Float(run.poses.vertices[0].ravel())
    return SparseGrid(run.posed(0), run.model.surface, vertices, max(preset.band, preset.band_inside), cell)


def points_of(rng, count, reach=0.45):
    return rng.uniform(-reach, reach, (count, 3)).astype(np.float32)


def at(found, points):
    sample = found.fused(mi.Point3f(points.T), mi.Vector3f(0.0, 0.0, 1.0))
    return np.concatenate([sample.sigma.numpy()[None], sample.sigma.numpy() * sample.colour.numpy()]).T


def test_it_is_linear_between_the_fields_values_at_the_nodes(make_run):
    run, density = make_ridge(make_run, peak=-0.5, srgb=(0.95, 0.8, 0.5))
    found = blocked(run)
    low = np.array(run.posed(0).bbox.min, np.float64).ravel()
    high = np.array(run.posed(0).bbox.max, np.float64).ravel()
    axes = [low[k] + CELL * np.arange(SIDE * int(np.ceil((high - low)[k] / CELL / SIDE)) + 1)
            for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    l = igl.signed_distance(nodes.reshape(-1, 3), run.poses.vertices[0].astype(np.float64),
                            run.body.faces.astype(np.int64),
                            igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[0]
    exact = RegularGridInterpolator(axes, density(l).reshape(nodes.shape[:3]))
    points = points_of(np.random.default_rng(0), 20000, 0.37)
    values = at(found, points)
    truth = exact(points.astype(np.float64))
    assert truth.max() > 20
    # Colours are one; what the linear values of these sRGB ones are, IEC 61966-2-1 says.
    linear = ((np.array([0.95, 0.8, 0.5]) + 0.055) / 1.055) ** 2.4
    assert values[:, 0] == pytest.approx(truth, rel=2e-3, abs=2e-2)
    assert values[:, 1:] == pytest.approx(truth[:, None] * linear, rel=3e-3, abs=2e-2)
    # Blocks are only where something is.
    whole = np.prod([len(axis) // SIDE for axis in axes])
    assert 0 < found.blocks < 0.9 * whole


def test_it_tends_to_the_field(make_run):
    """The error of linear interpolation falls with the square of the spacing, where the density is smooth."""
    run, density = make_ridge(make_run, peak=-0.5, slope=4.0)
    points = points_of(np.random.default_rng(1), 20000)
    posed = run.posed(0)
    posed.bound.pack()
    truth = posed.fused(mi.Point3f(points.T), mi.Vector3f(0.0, 0.0, 1.0)).sigma.numpy()
    errors = [np.abs(at(blocked(run, cell), points)[:, 0] - truth).mean() / truth.mean()
              for cell in (0.02, 0.005)]
    assert errors[0] < 0.1 and errors[1] < errors[0] / 6


def test_majorant_is_above_every_value_and_outside_is_nothing(make_run):
    run, _ = make_ridge(make_run)
    found = blocked(run)
    points = points_of(np.random.default_rng(2), 50000)
    sigma = at(found, points)[:, 0]
    assert sigma.max() < found.majorant < 1.1 * sigma.max()
    strange = np.array([[1e30, 0, 0], [np.inf, 0, 0], [np.nan, 0, 0], [0, -0.5, 0], [0, 0, 0]], np.float32)
    assert (at(found, strange) == 0).all()


def test_nothing_at_all_is_a_field_too(make_run):
    found = blocked(make_run(density_bias=-60.0))
    assert found.blocks == 0 and found.majorant > 0
    assert (at(found, points_of(np.random.default_rng(3), 100)) == 0).all()


def test_too_fine_a_grid_is_refused_before_it_is_made(make_run, monkeypatch):
    with pytest.raises(InputError, match="memory"):
        blocked(make_run(), 1e-5)
    monkeypatch.setattr(sparse_grid, "LARGEST", 1 << 20)
    with pytest.raises(InputError, match="about 0.0"):
        blocked(make_run())


# The medium.


def scene_of(run, integrator="volpath", **more):
    return mi.load_dict({
        "type": "scene", "integrator": {"type": integrator, "max_depth": 6}, "light": {"type": "constant"},
        "sensor": {"type": "perspective", "fov": 28,
                   "to_world": mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                   "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"},
                            "pixel_format": "rgb"}},
        "performer": {"type": "ndf_shell", "layers": 3,
                      "interior": {"type": "ndf", "run": str(run.path), **more}}})


def means(scene, count=6):
    return np.array([mi.render(scene, spp=128, seed=seed).numpy().mean((0, 1)) for seed in range(count)],
                    np.float64)


def test_paths_see_the_same_in_it(make_run):
    run, _ = make_ridge(make_run, peak=-0.5, slope=6.0, srgb=(0.95, 0.8, 0.5), direction_octaves=-1)
    field, gridded = means(scene_of(run)), means(scene_of(run, grid_spacing=0.004))
    noise = np.sqrt(field.var(0, ddof=1) / 6 + gridded.var(0, ddof=1) / 6)
    assert (np.abs(field.mean(0) - gridded.mean(0)) < 4 * noise + 2e-3).all()
    assert (noise < 0.01).all() and field.mean() < 0.97


def test_it_follows_the_parameters(make_run):
    run, _ = make_ridge(make_run, peak=-0.5, direction_octaves=-1)
    scene = scene_of(run, grid_spacing=0.01)
    before = means(scene, 2).mean()
    parameters = mi.traverse(scene)
    key = next(key for key in parameters.keys() if key.endswith("weights"))  # noqa: SIM118 - not a dict
    parameters[key] = parameters[key] * 0.0 - 1.0
    parameters.update()
    assert abs(means(scene, 2).mean() - before) > 0.005


def test_gradients_are_refused(make_run):
    run, _ = make_ridge(make_run, direction_octaves=-1)
    scene = scene_of(run, "prbvolpath", grid_spacing=0.02)
    parameters = mi.traverse(scene)
    key = next(key for key in parameters.keys() if key.endswith("weights"))  # noqa: SIM118 - not a dict
    dr.enable_grad(parameters[key])
    parameters.update()
    with pytest.raises(RuntimeError) as raised:
        dr.backward(mi.render(scene, parameters, spp=1))
    error: BaseException | None = raised.value
    while not isinstance(error, InputError):
        # Dr.Jit's loops say where; what is wrong is behind them.
        error = error.__cause__
    assert "detached" in str(error)
    # While the traceback keeps the medium alive, every other scene's loops would trace it, too.
    del scene, parameters, raised, error
    gc.collect()


@pytest.mark.parametrize(("more", "text"),
                         [({"grid_spacing": -1.0}, "-1"), ({"grid_spacing": float("nan")}, "nan")])
def test_bad_spacings_are_refused(make_run, more, text):
    with pytest.raises(RuntimeError, match=text):
        scene_of(make_run(), **more)


def test_colours_that_depend_on_the_view_are_refused(make_run):
    run = make_run(direction_octaves=2)
    assert dataclasses.asdict(run.model.field.preset)["direction_octaves"] == 2
    with pytest.raises(RuntimeError, match="view direction"):
        scene_of(run, grid_spacing=0.01)


def test_the_old_name_of_the_spacing_works(make_run, capsys):
    run, _ = make_ridge(make_run, direction_octaves=-1)
    medium = mi.load_dict({"type": "ndf", "run": str(run.path), "lattice": 0.05})
    assert medium.grid_spacing == 0.05
    assert "grid_spacing" in capsys.readouterr().err
