"""The scenes under `ndf_path`: they load with little more than a run, show their performers, and do what
their parameters say."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "scenes"
NAMES = ("turntable", "studio", "two", "environment")
SMALL = {"width": 16, "height": 16, "spp": 4, "origin": "0, 0.5, 2", "target": "0, 0.2, 0"}


def load(name, run, **change):
    return mi.load_file(str(SCENES / f"{name}.xml"), run=str(run.path), **{**SMALL, **change})


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_loads_with_defaults_and_shows_its_performer(make_run, name):
    run = make_run(density_limit=20.0, density_gain=10.0)
    defaults = mi.load_file(str(SCENES / f"{name}.xml"), run=str(run.path))
    assert list(defaults.sensors()[0].film().size()) == [256, 256]
    scene = load(name, run)
    image = mi.render(scene).numpy()
    assert image.shape == (16, 16, 3) and np.isfinite(image).all() and image.std() > 0.01
    assert scene.integrator().transport.evaluated > 0


def test_the_turntable_turns(make_run):
    """By a quarter from the front: the camera that stood on z stands on x, and sees the same before as behind
    a full turn."""
    run = make_run(density_limit=20.0)

    def sensor(angle):
        return mi.traverse(load("turntable", run,
                                angle=angle).sensors()[0])["to_world"].matrix.numpy().reshape(4, 4)

    np.testing.assert_allclose(sensor(90)[:3, 3], [2, 0.5, 0], atol=1e-6)
    np.testing.assert_allclose(sensor(0), sensor(360), atol=1e-5)
    assert not np.allclose(*(mi.render(load("turntable", run, angle=angle)).numpy() for angle in (0, 90)),
                           atol=1e-3)


def test_two_performers_stand_where_they_were_put(make_constant_run):
    """By the medium's offset; and a run whose poses are moved is a performer elsewhere too, in the same
    picture."""
    run, other = (make_constant_run(60.0, (0.9, 0.1, 0.1)),
                  make_constant_run(60.0, (0.1, 0.1, 0.9), name="other"))
    view = {"width": 32, "height": 16, "origin": "0.45, 0.3, 3", "target": "0.45, 0.3, 0", "spp": 16}
    image = mi.render(load("two", run, other=str(other.path), other_offset="0.9, 0, 0", **view)).numpy()
    left, right = image[4:12, :16], image[4:12, 16:]
    assert (left[..., 0] > 2 * left[..., 2]).any() and not (left[..., 2] > 2 * left[..., 0]).any()
    assert (right[..., 2] > 2 * right[..., 0]).any() and not (right[..., 0] > 2 * right[..., 2]).any()
    other.poses.vertices[:] += np.float32([0.9, 0, 0])
    other.save()
    moved = mi.render(load("two", run, other=str(other.path), other_offset="0, 0, 0", **view)).numpy()
    np.testing.assert_allclose(moved, image, atol=1e-4)


def test_every_scene_is_in_the_readme_and_has_its_picture():
    text = (SCENES / "README.md").read_text(encoding="utf-8")
    for path in SCENES.glob("*.xml"):
        assert f"`{path.name}`" in text
    for name in NAMES:
        picture = ROOT / "docs" / "images" / f"{name}.png"
        assert 0 < picture.stat().st_size < 200_000
        assert f"images/{name}.png" in (ROOT / "docs" / "ndf-path.md").read_text(encoding="utf-8")
