"""The lights of a capture, and the refusal of scenes without lights."""

import mitsuba as mi
import pytest

from ndf_mi.errors import InputError
from ndf_mi.render.scene import lights


def write(path, inside):
    path.write_text(f'<scene version="3.0.0">{inside}</scene>')
    return path


def test_emitters_and_shapes_of_a_scene_shine_in_another(tmp_path):
    file = write(tmp_path / "light.xml", """
        <emitter type="constant"/> <integrator type="direct"/> <sensor type="perspective"/>
        <emitter type="directional"><vector name="direction" value="0, 0, 1"/></emitter>
        <shape type="rectangle"><emitter type="area"/></shape> <shape type="sphere"/>""")
    found = lights(file)
    assert len(found) == 4
    scene = mi.load_dict({"type": "scene", **found})
    assert len(scene.emitters()) == 3 and len(scene.shapes()) == 2
    assert not scene.sensors()


@pytest.mark.parametrize(("inside", "words"), [
    ('<shape type="sphere"/>', "without an emitter"),
    ('<emitter type="moon"/>', "cannot be loaded"),
    ('<emitter type="envmap"><string name="filename" value="lost.exr"/></emitter>', "cannot be loaded"),
])
def test_scenes_without_lights_are_refused(tmp_path, inside, words):
    with pytest.raises(InputError, match=words):
        lights(write(tmp_path / "light.xml", inside))


def test_a_missing_scene_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        lights(tmp_path / "light.xml")
