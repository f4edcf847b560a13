"""Runs on disk: one that several plugins name is loaded once, and again when its files change."""

import gc

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.render.performers import FieldMedium
from ndf_mi.run import Run


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
