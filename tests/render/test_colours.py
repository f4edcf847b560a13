"""Runs that are lit though their colours hold light, or shown as light though these are albedos: one warning,
or none."""

import mitsuba as mi
import pytest

from ndf_mi.render.scene_issues import scene_issues

LIGHT, ALBEDO = {"steps": 9}, {"steps": 9, "integrator": "prbvolpath", "warm_up": 5}


def scene_of(run, integrator, layers=0):
    return mi.load_dict({
        "type": "scene", "integrator": {"type": integrator}, "light": {"type": "constant"},
        "sensor": {"type": "perspective",
                   "to_world": mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                   "film": {"type": "hdrfilm", "width": 4, "height": 4}},
        "performer": {"type": "ndf_shell", "layers": layers,
                      "interior": {"type": "ndf", "run": str(run.path)}}})


@pytest.mark.parametrize("layers", [0, 2])
@pytest.mark.parametrize(("training", "integrator", "expected"), [
    (LIGHT, "volpath", True), (LIGHT, "prbvolpath", True), (LIGHT, "ndf_path", False),
    (ALBEDO, "volpath", False), (None, "volpath", False),
])
def test_a_check_of_the_scene_finds_light_taken_for_albedo(make_constant_run, training, integrator, expected,
                                                           layers):
    run = make_constant_run(20.0)
    run.config["training"] = training
    run.save()
    issues = [issue for issue in scene_issues(scene_of(run, integrator, layers)) if str(run.path) in issue]
    assert len(issues) == expected and all("light" in issue and "ndf_quadrature" in issue for issue in issues)


@pytest.mark.parametrize(("training", "integrator", "expected"), [
    (ALBEDO, "ndf_path", True), (ALBEDO, "ndf_quadrature", True), (LIGHT, "ndf_path", False),
    (None, "ndf_quadrature", False),
    (LIGHT, "volpath", False),
])
def test_integrators_warn_once_of_albedo_taken_for_light(make_constant_run, capfd, training, integrator,
                                                         expected):
    run = make_constant_run(20.0)
    run.config["training"] = training
    run.save()
    for _ in range(2):
        mi.render(scene_of(run, integrator), spp=1)
    printed = "".join(capfd.readouterr())
    assert printed.count("albedos") == expected and (str(run.path) in printed) == expected


@pytest.mark.parametrize(("training", "trained", "expected"), [
    (None, None, None),
    (LIGHT, {"steps": 9}, "light"),
    (ALBEDO, None, "albedo"),
    (ALBEDO, {"steps": 9}, "albedo"),
    # It ended before scattering began.
    (ALBEDO, {"steps": 5}, "light"),
])
def test_a_run_records_what_its_colours_are(make_run, training, trained, expected):
    run = make_run()
    run.config |= {"training": training, "trained": trained}
    assert run.colours == expected
