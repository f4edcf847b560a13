"""Runs on disk: one that several plugins name is loaded once, and again when its files change."""

import gc

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.render.performers import FieldMedium
from ndf_mi.run import SURFACE, Run


@pytest.fixture
def loads(monkeypatch):
    """Counts how often a run is loaded."""
    count = []
    load = Run.load.__func__
    monkeypatch.setattr(Run, "load", classmethod(lambda cls, path: count.append(path) or load(cls, path)))
    return count


def scene_of(run, layers=0):
    medium = {"type": "ndf", "run": str(run.path)}
    return mi.load_dict({"type": "scene",
                         "performer": {"type": "ndf_shell", "run": str(run.path), "layers": layers,
                                       "interior": medium}})


@pytest.mark.parametrize("layers", [0, 2])
def test_shell_and_medium_share_one_run(make_run, loads, layers):
    scene = scene_of(make_run(), layers)
    assert len(loads) == 1
    media = [shape.interior_medium() for shape in scene.shapes()]
    assert all(isinstance(medium, FieldMedium) for medium in media)
    assert [medium.outermost for medium in media] == [True] + [False] * (len(media) - 1)
    assert len({medium.neural_field for medium in media}) == 1


def test_a_run_that_changed_on_disk_is_loaded_again(make_run, loads):
    run = make_run()
    before = scene_of(run)
    run.parameters = run.parameters.replace(weights=2.0 * run.parameters.weights)
    run.save_field()
    after = scene_of(run)
    assert len(loads) == 2
    weights = [mi.traverse(scene)["performer.interior_medium.weights"].numpy() for scene in (before, after)]
    np.testing.assert_array_equal(weights[1], 2 * weights[0])


def test_a_run_that_nothing_holds_is_let_go(make_run, loads):
    run = make_run()
    held = Run.shared(run.path)
    assert Run.shared(str(run.path)) is held and len(loads) == 1
    del held
    gc.collect()
    Run.shared(run.path)
    assert len(loads) == 2


def test_other_media_are_no_field_media():
    grid = mi.load_dict({"type": "ndf_grid", "nx": 2, "ny": 2, "nz": 2, "cell": 0.1})
    assert not isinstance(grid, FieldMedium) and not isinstance(mi.load_dict({"type": "homogeneous"}),
                                                                FieldMedium)


def test_the_reference_surface_is_kept_with_the_run(make_run):
    run = make_run()
    assert run.surface_tensors == {} and not (run.path / SURFACE).exists()
    offsets = np.arange(3 * run.poses.vertices.shape[1], dtype=np.float32).reshape(-1, 3)
    run.surface_tensors = {"offsets": offsets}
    run.save()
    read = Run.load(run.path)
    np.testing.assert_array_equal(read.surface_tensors["offsets"], offsets)
    assert read.bands is None and read.config["version"] == 1


def test_a_run_around_the_body_leaves_no_older_surface(make_run):
    run = make_run()
    run.surface_tensors = {"bands": np.full((run.poses.vertices.shape[1], 2), 0.01, np.float32)}
    run.save_surface()
    run.surface_tensors = {}
    run.save()
    assert not (run.path / SURFACE).exists() and Run.load(run.path).bands is None


def test_a_surface_that_does_not_fit_is_named(make_run):
    run = make_run()
    run.surface_tensors = {"offsets": np.zeros((1, 3), np.float32)}
    run.save()
    with pytest.raises(InputError, match=r"surface\.safetensors: offsets.*\(1, 3\)"):
        Run.load(run.path)
    run.surface_tensors = {"other": np.full(2, np.nan, np.float32)}
    run.save()
    with pytest.raises(InputError, match=r"surface\.safetensors: other.*not finite"):
        Run.load(run.path)


def test_shared_runs_notice_another_surface(make_run, loads):
    run = make_run()
    first = Run.shared(run.path)
    run.surface_tensors = {"offsets": np.zeros((run.poses.vertices.shape[1], 3), np.float32)}
    run.save_surface()
    assert Run.shared(run.path) is not first
