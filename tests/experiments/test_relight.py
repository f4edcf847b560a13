"""Relighting as a whole on small captures, the diffuse mesh on its own, and what is refused."""

import json
import shutil

import mitsuba as mi
import numpy as np
import pytest
from sphere_capture import ring_camera

from ndf_mi import commands
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.field import preset
from ndf_mi.learn.loop import start, train
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import relightable
from ndf_mi.learn.scattering_scene import expect_outside
from ndf_mi.methods.lit_field import LitField
from ndf_mi.methods.lit_mesh import LitMesh
from ndf_mi.methods.lit_surface import ReflectanceFit
from ndf_mi.render.lights import lights
from ndf_mi.surface import texture_fit as mesh_fit


@pytest.fixture
def captures(make_constant_run, lit_capture):
    truth = make_constant_run(25.0, srgb=(0.9, 0.7, 0.5), name="truth", direction_octaves=-1, normal_octaves=-1)
    return lit_capture(truth, "day"), lit_capture(truth, "night")


@pytest.fixture
def trained(captures, tmp_path):
    tiny, _ = relightable(preset("tiny"))
    options = TrainingOptions(steps=4, warm_up=2, rays=64, samples=16, paths=2, max_depth=4, cell=0.03, integrator="prbvolpath")
    train(start(tmp_path / "run", captures[0], tiny, options), quiet=True)
    return tmp_path / "run"


@pytest.fixture
def quick(monkeypatch):
    for name, value in (("SWEEP_STEPS", 2), ("WINDOW_STEPS", 4), ("MAX_STEPS", 8), ("RATES", (3e-2, 1e-1))):
        monkeypatch.setattr(mesh_fit, name, value)
    # The default of an argument.
    monkeypatch.setattr(mesh_fit.TextureFit.to_convergence, "__defaults__", (None, 8))


def call(run, capture, under, out, *more):
    return commands.main(["relight", str(run), "--capture", str(capture.path), "--under", str(under.path), "-o", str(out),
                          "--spp", "8", "--texture", "16", *more])


@pytest.mark.long
def test_it_measures_both_under_both_lights_and_keeps_what_is_there(captures, trained, quick, tmp_path, capsys):
    out = tmp_path / "out"
    assert call(trained, *captures, out) == 0
    said = capsys.readouterr().out
    assert "Seen light, novel views" in said and "Unseen light, novel views" in said and "Noise of the pictures" in said
    documents = {name: json.loads((out / f"{name}.json").read_text()) for name in ("seen", "unseen")}
    for document in documents.values():
        assert [method["key"] for method in document["methods"]] == ["ndf", "mesh"]
        assert all(len(method["images"]) == 1 for method in document["methods"])
    report = (out / "report.html").read_text()
    assert "Under the seen light" in report and "Under the unseen light" in report and report.count("data:image/png") >= 10
    stamp = (out / "relight" / "mesh" / "mesh.safetensors").stat().st_mtime_ns
    pictures = {file: file.stat().st_mtime_ns for file in out.rglob("*.png")}
    assert call(trained, *captures, out) == 0
    assert (out / "relight" / "mesh" / "mesh.safetensors").stat().st_mtime_ns == stamp
    assert {file: file.stat().st_mtime_ns for file in out.rglob("*.png")} == pictures


@pytest.mark.long
def test_captures_that_do_not_belong_are_refused(captures, trained, make_run, tmp_path, capsys):
    day, night = captures
    out = tmp_path / "out"
    # One that ended before scattering began.
    early = shutil.copytree(trained, tmp_path / "early")
    config = json.loads((early / "config.json").read_text())
    config["trained"]["steps"] = 2
    (early / "config.json").write_text(json.dumps(config))
    for arguments, words in (
        ((trained, night, day), ["the one that"]),
        ((trained, day, day), ["in another light"]),
        ((make_run("other").path, day, night), ["training.integrator", "prbvolpath"]),
        ((tmp_path / "nothing", day, night), ["config.json"]),
        ((early, day, night), ["trained.steps", "more than the 2 steps by quadrature", "warm_up"]),
    ):
        assert call(*arguments, out) == 2
        said = capsys.readouterr().err
        assert all(word in said for word in words), said
    assert call(trained, day, night, out, "--spp", "7") == 2
    assert call(trained, day, night, out, "--lattice", "-1") == 2
    assert not out.exists()


@pytest.mark.long
def test_a_lattice_shows_what_the_field_itself_shows(make_constant_run, captures):
    """Constant extinction and albedo: but for the band's edges, where the lattice smooths over a cell, the two are the same medium."""
    run = make_constant_run(25.0, srgb=(0.9, 0.7, 0.5), direction_octaves=-1, normal_octaves=-1)
    capture = captures[0]
    images, noise = [], 0.0
    for lattice in (0.0, 0.01):
        method = LitField(run, lights(capture.known_lighting()), "day", 64, 6, [1], lattice)
        images.append(method.render(capture.cameras["n0"], 1))
        noise += method.noise[0]
    inside = capture.mask("n0", 1)
    bias = (images[1] - images[0])[inside].mean(0)
    assert np.abs(bias).max() < 0.01 + 3 * np.sqrt(noise / inside.sum())
    assert method.fingerprint() != LitField(run, {}, "day", 64, 6, [1]).fingerprint()


def test_a_camera_inside_the_band_is_refused(make_constant_run):
    """And one outside of it and of its shell is not: at 2 m nothing is asked of the body at all."""
    run = make_constant_run(25.0)
    camera = ring_camera("near", 0.0)
    for distance, near in ((0.36, True), (0.41, True), (0.45, False), (2.0, False)):
        camera.transform[:3, 3] = [0.05, 0, distance]
        if not near:
            expect_outside(run, camera, 1)
            continue
        with pytest.raises(InputError, match="camera 'near', frame 1.*inside the performer's band"):
            LitField(run, {}, "day", 2, 4, [1]).render(camera, 1)


@pytest.mark.long
def test_the_diffuse_mesh_recovers_a_reflectance_and_shows_it_in_another_light(captures):
    """The truth here is the mesh itself with a grey texture, path traced by Mitsuba."""
    capture = captures[0]
    known = {name: LitMesh(c, 16, spp=64) for name, c in zip(("day", "night"), captures, strict=True)}
    grey = np.full((16, 16, 3), (0.7, 0.5, 0.3), dtype=np.float32)
    shown = {}
    for name, mesh in known.items():
        mesh.texture = grey
        shown[name] = {(camera, frame): mesh.render(capture.cameras[camera], frame) for camera in capture.cameras for frame in (0, 1)}
    capture.image = lambda camera, frame: shown["day"][camera, frame]
    mesh = LitMesh(capture, 16, spp=64)
    fit = ReflectanceFit(mesh._surface, capture, 16, 0.05, 0)
    fit.for_steps(60)
    seen = fit.seen()
    assert np.abs(fit.texture()[seen].mean(0) - grey[0, 0]).max() < 0.03
    mesh.texture = np.where(seen[..., None], fit.texture(), grey)
    other = mesh.under(capture, lights(captures[1].known_lighting()), "night", 64)
    image = other.render(capture.cameras["n0"], 1)
    mask = metrics.box_mask(capture.cameras["n0"], capture.poses.vertices[1])
    assert metrics.psnr(shown["night"]["n0", 1], image, mask) > 28


@pytest.mark.long
def test_a_diffuse_ball_in_white_light_has_the_brightness_of_its_albedo(captures):
    """In the furnace a convex diffuse body is seen with radiance albedo × sky."""
    capture = captures[0]
    mesh = LitMesh(capture, 8, lights={"sky": mi.load_dict({"type": "constant"})})
    mesh.texture = np.full((8, 8, 3), 0.735357, dtype=np.float32)  # sRGB of 0.5
    image = mesh.render(capture.cameras["c0"], 0)
    middle = image[10:14, 10:14]
    np.testing.assert_allclose(middle.mean((0, 1)), 0.7354, atol=0.01)
