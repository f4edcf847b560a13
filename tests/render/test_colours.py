"""Runs that are lit though their colours hold light, or shown as light though these are albedos: told once each, or not at all."""

import mitsuba as mi
import pytest

from ndf_mi.render import colours

LIGHT, ALBEDO = {"steps": 9}, {"steps": 9, "integrator": "prbvolpath", "warm_up": 5}


@pytest.fixture(autouse=True)
def nothing_told(monkeypatch):
    monkeypatch.setattr(colours, "_told", set())


def scene_of(run, integrator, layers):
    return mi.load_dict({
        "type": "scene", "integrator": {"type": integrator}, "light": {"type": "constant"},
        "sensor": {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
                   "film": {"type": "hdrfilm", "width": 4, "height": 4}},
        "performer": {"type": "ndf_shell", "layers": layers, "interior": {"type": "ndf", "run": str(run.path)}}})


@pytest.mark.parametrize("layers", [0, 2])
@pytest.mark.parametrize(("training", "integrator", "word"), [
    (LIGHT, "volpath", "lights are added"),
    (LIGHT, "prbvolpath", "lights are added"),
    (LIGHT, "ndf_path", None),
    (ALBEDO, "volpath", None),
    (ALBEDO, "ndf_path", "as if they were light"),
    (ALBEDO, "ndf_quadrature", "as if they were light"),
    (None, "volpath", None),
    (None, "ndf_quadrature", None),
])
def test_what_is_taken_for_something_else_is_told_once(make_constant_run, capfd, training, integrator, word, layers):
    run = make_constant_run(20.0)
    run.config["training"] = training
    run.save()
    for _ in range(2):
        mi.render(scene_of(run, integrator, layers), spp=1)
    said = "".join(capfd.readouterr())
    assert said.count("its colours") == (word is not None)
    assert word is None or (word in said and str(run.path) in said)


@pytest.mark.parametrize(("training", "trained", "expected"), [
    (None, None, None),
    (LIGHT, {"steps": 9}, "light"),
    (ALBEDO, None, "albedo"),
    (ALBEDO, {"steps": 9}, "albedo"),
    # It ended before scattering began.
    (ALBEDO, {"steps": 5}, "light"),
])
def test_a_run_says_what_its_colours_are(make_run, training, trained, expected):
    run = make_run()
    run.config |= {"training": training, "trained": trained}
    assert run.colours == expected
