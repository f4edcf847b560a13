"""The check of scenes finds what Mitsuba's own integrators would render wrongly without a warning."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from field_scenes import performer, scene_of, sensor
from ridge_field import make_ridge

from ndf_mi.render.scene_issues import open_edges, scene_issues


def test_a_check_finds_what_a_scene_gets_wrong(make_run):
    run, _ = make_ridge(make_run)
    medium = {"type": "ndf", "run": str(run.path)}
    null = {"type": "null"}
    assert scene_issues(scene_of({"performer": performer(run)})) == []
    assert scene_issues(scene_of({"ball": {"type": "sphere", "radius": 0.4, "bsdf": null,
                                           "interior": medium}})) == []
    assert scene_issues(scene_of({"ball": {"type": "sphere"}})) == []

    def only(scene, *words):
        (text,) = scene_issues(scene)
        for word in words:
            assert word in text
        return text

    for name in ("path", "direct", "prb"):
        only(mi.load_dict({"type": "scene", "integrator": {"type": name}, "performer": performer(run)}),
             "knows no media", "volpath")
    only(scene_of({"small": {"type": "sphere", "radius": 0.31, "bsdf": null, "interior": medium}}), "small",
         "% of the field")
    only(scene_of({"inward": {"type": "sphere", "radius": 0.4, "flip_normals": True, "bsdf": null,
                              "interior": medium}}), "faces inward")
    only(scene_of({"grey": {"type": "sphere", "radius": 0.4, "interior": medium}}), "surface of its own",
         "null")
    only(scene_of({"flat": {"type": "rectangle", "bsdf": null, "interior": medium}}), "encloses nothing")
    only(scene_of({"performer": performer(run)}, camera=sensor((0, 0, 0.33))), "sensor 0 is inside",
         "'performer'", "<ref")
    only(scene_of({"performer": performer(run)}, "prbvolpath", camera=sensor((0, 0, 0.33))),
         "begins outside of media")
    only(scene_of({"mine": {"type": "ndf_shell", "run": str(run.path)}}), "'mine'", "neither a surface",
         "`ndf` medium")
    assert scene_issues(scene_of({"glass": {"type": "sphere", "radius": 0.4, "bsdf": {"type": "dielectric"},
                                            "interior": medium}})) == []


def test_integrators_within_others_are_looked_at(make_run):
    shape = {"performer": performer(make_ridge(make_run)[0])}

    def found(inner, outer="aov", **more):
        return scene_issues(mi.load_dict({"type": "scene",
                                          "integrator": {"type": outer, "inner": {"type": inner}, **more},
                                          **shape}))

    for inner in ("path", "volprim_rf_basic"):
        (text,) = found(inner, aovs="d:depth")
        assert "knows no media" in text
    assert len(found("direct", "moment")) == 1
    for inner in ("volpath", "ndf_path", "ndf_quadrature"):
        assert found(inner, aovs="d:depth") == found(inner, "moment") == []


@pytest.mark.parametrize("integrator", ["ndf_path", "ndf_quadrature"])
def test_what_the_packages_integrators_can_show_is_no_issue(make_run, integrator):
    """A camera in the band, a carrier smaller than it, one that is open or refracts."""
    medium = {"type": "ndf", "run": str(make_ridge(make_run)[0].path)}
    for shape in ({"type": "sphere", "radius": 0.31, "bsdf": {"type": "null"}},
                  {"type": "rectangle", "bsdf": {"type": "null"}},
                  {"type": "sphere", "radius": 0.4, "bsdf": {"type": "dielectric"}}):
        assert scene_issues(scene_of({"carrier": {**shape, "interior": medium}}, integrator,
                                     camera=sensor((0, 0, 0.33)))) == []


def test_performers_that_meet_are_found(make_run):
    run, _ = make_ridge(make_run)

    def found(*offset, integrator="volpath"):
        return scene_issues(scene_of({"one": performer(run), "other": performer(run, offset=list(offset))},
                                     integrator))

    (text,) = found(0.7, 0.0, 0.0)
    assert "'one'" in text and "'other'" in text and "meet" in text
    # Their boxes overlap, they do not; and what absorbs and emits may overlap.
    assert found(0.65, 0.65, 0.0) == found(1.0, 0.0, 0.0) == found(0.7, 0.0, 0.0, integrator="ndf_path") == []


def test_an_open_mesh_is_found(make_run, tmp_path):
    run, _ = make_ridge(make_run)
    ball = trimesh.creation.icosphere(2, 0.4)
    assert open_edges(ball.vertices, ball.faces) == 0
    ball.update_faces(np.arange(len(ball.faces)) != 7)
    assert open_edges(ball.vertices, ball.faces) == 3
    touching = trimesh.util.concatenate([trimesh.creation.box(),
                                         trimesh.creation.box().apply_translation([1, 1, 0])])
    assert open_edges(touching.vertices, touching.faces) == 0  # four triangles at the edge where they touch
    ball.export(tmp_path / "open.ply")
    scene = scene_of({"mine": {"type": "ply", "filename": str(tmp_path / "open.ply"),
                               "bsdf": {"type": "null"},
                               "interior": {"type": "ndf", "run": str(run.path)}}})
    (text,) = scene_issues(scene)
    assert "mine" in text and "not closed (3 open edges)" in text and "ndf_shell" in text
