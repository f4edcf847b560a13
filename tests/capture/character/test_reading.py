"""Reading characters: what is in the file, exactly; and refusals of what is wrong with it."""

from __future__ import annotations

import base64
import copy
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rigged_character import JOINTS, Glb, boxes
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from ndf_mi.capture.synthesise.character.animation import Track
from ndf_mi.capture.synthesise.character.buffers import Buffers
from ndf_mi.capture.synthesise.character.character import Character
from ndf_mi.capture.synthesise.character.document import read_document
from ndf_mi.capture.synthesise.character.frames import choose_spans
from ndf_mi.capture.synthesise.character.joints import REQUIRED, match_joints
from ndf_mi.colour import srgb_to_linear
from ndf_mi.errors import InputError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return boxes().write(tmp_path / "boxes.glb")


def animation(character: Character, name: str) -> Any:
    return next(found for found in character.animations if found.name == name)


def test_vertices_move_with_their_joint_in_metres(path: Path) -> None:
    character = Character(path)
    at = {name: np.array(position) / 100 for name, _, position in JOINTS}
    world = character.world(animation(character, "raise"), np.array([0.0, 1.0]))
    part = character.parts[0]
    (still, raised), = character.vertices(world)
    np.testing.assert_allclose(still, part.rest / 100, atol=1e-6)
    # The arm turns by 90° about z around its joint, with the forearm and the hand.
    names = [name for name, _, _ in JOINTS]
    arm = [names.index(f"Left{name}") for name in ("Arm", "ForeArm", "Hand")]
    moved = np.concatenate([np.arange(8 * j, 8 * j + 8) for j in arm])
    away = still[moved] - at["LeftArm"]
    turned = at["LeftArm"] + away @ Rotation.from_euler("z", 90, degrees=True).as_matrix().T
    np.testing.assert_allclose(raised[moved], turned, atol=1e-6)
    rest = np.setdiff1d(np.arange(len(still)), moved)
    np.testing.assert_allclose(raised[rest], still[rest], atol=1e-6)


def test_the_picture_is_linear_and_tinted(path: Path) -> None:
    picture = Character(path).parts[0].picture
    assert picture is not None and picture.opaque is None
    expected = np.asarray(srgb_to_linear(np.array([200, 100, 0]) / 255)) * [1, 1, 0.5]
    np.testing.assert_allclose(picture.colour[0, 0], expected, atol=1e-6)
    np.testing.assert_allclose(Character(path).parts[0].uv[0], [0.25, 0.25], atol=1e-6)


def test_tracks_interpolate_as_the_specification_says() -> None:
    times, values = np.array([0.0, 1.0, 3.0]), np.array([[0.0, 1, 2], [2, 0, 1], [4, 5, 6]])
    at = np.array([-1.0, 0.25, 1.0, 2.9, 3.0, 7.0])
    step = Track(0, "translation", times, values, "STEP").at(at)
    np.testing.assert_array_equal(step, values[[0, 0, 1, 1, 2, 2]])
    linear = Track(0, "translation", times, values, "LINEAR").at(at)
    np.testing.assert_allclose(linear, np.stack([np.interp(at, times, v) for v in values.T], axis=1))
    slopes = np.array([[1.0, 0, 0], [0, 2, 0], [1, 1, 1]])
    keys = np.stack([slopes, values, slopes], axis=1)
    spline = Track(0, "translation", times, keys, "CUBICSPLINE").at(at)
    expected = CubicHermiteSpline(times, values, slopes)(np.clip(at, 0, 3))
    np.testing.assert_allclose(spline, expected, atol=1e-12)
    # Rotations take the shorter way, whatever the sign of the quaternion.
    quats = Rotation.from_euler("z", [[0], [90]], degrees=True).as_quat() * [[1], [-1]]
    half = Track(0, "rotation", times[:2], quats, "LINEAR").at(np.array([0.5]))
    assert abs(Rotation.from_quat(half[0]).magnitude() - np.pi / 4) < 1e-9


def test_sparse_quantised_and_strided_arrays(tmp_path: Path) -> None:
    glb = Glb()
    rows = np.zeros((3, 8), np.uint8)
    rows[:, :3] = [[0, 51, 255], [255, 0, 0], [102, 102, 102]]
    view = glb.view(rows.tobytes(), byteStride=8)
    glb.json["accessors"].append({"bufferView": view, "componentType": 5121, "normalized": True, "count": 3,
                                  "type": "VEC3", "sparse": {
        "count": 1, "indices": {"bufferView": glb.view(b"\2"), "componentType": 5121},
        "values": {"bufferView": glb.view(b"\xff\0\xff")}}})
    found = Buffers(read_document(glb.write(tmp_path / "a.glb"))).numbers(0, ("VEC3",), "here")
    np.testing.assert_allclose(found, [[0, 0.2, 1], [1, 0, 0], [1, 0, 1]])


def test_external_buffers_lie_next_to_the_file(path: Path, tmp_path: Path) -> None:
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    folder = tmp_path / "model"
    folder.mkdir()
    file = folder / "boxes.gltf"

    def write(uri: str) -> Path:
        document["buffers"][0]["uri"] = uri
        file.write_text(json.dumps(document))
        return file

    (folder / "the data.bin").write_bytes(binary)
    expected = Character(path).parts[0].rest
    inside = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    for uri in ("the%20data.bin", inside):
        np.testing.assert_array_equal(Character(write(uri)).parts[0].rest, expected)
    (tmp_path / "outside.bin").write_bytes(binary)
    for uri in ("../outside.bin", str(tmp_path / "outside.bin"), "https://example.org/a.bin", "missing.bin",
                "data:;base64,???", "\0"):
        with pytest.raises(InputError, match=r"buffers\[0\]"):
            Character(write(uri))


def test_centimetres_and_z_up_become_metres_and_y_up(tmp_path: Path) -> None:
    glb = boxes()
    glb.json["nodes"][0] |= {"scale": [1, 1, 1], "rotation": Rotation.from_euler("x", 90, degrees=True)
                             .as_quat().tolist()}
    character = Character(glb.write(tmp_path / "boxes.glb"))
    assert any("centimetres" in note for note in character.notes) and len(character.notes) == 2
    (vertices,) = character.vertices(character.world(animation(character, "raise"), np.zeros(1)))
    np.testing.assert_allclose(vertices[0], character.parts[0].rest / 100, atol=1e-6)


NAMES = {
    "mixamo": ("mixamorig7:{Side}UpLeg", "mixamorig7:{Side}Arm", "mixamorig7:Head"),
    "unreal": ("thigh_{s}", "upperarm_{s}", "head"),
    "biped": ("Bip01 {S} Thigh", "Bip01 {S} UpperArm", "Bip01 Head"),
    "vrm": ("J_Bip_{S}_UpperLeg", "J_Bip_{S}_UpperArm", "J_Bip_C_Head"),
    "rigify": ("DEF-thigh.{S}", "DEF-upper_arm.{S}", "DEF-head"),
}
REST = {
    "mixamo": ("Leg", "Foot", "ForeArm", "Hand"), "unreal": ("calf_", "foot_", "lowerarm_", "hand_"),
    "biped": ("Calf", "Foot", "Forearm", "Hand"), "vrm": ("LowerLeg", "Foot", "LowerArm", "Hand"),
    "rigify": ("shin", "foot", "forearm", "hand"),
}


@pytest.mark.parametrize("rig", NAMES)
def test_common_rigs_are_known_by_their_names(rig: str) -> None:
    first, arm, head = NAMES[rig]
    names, expected = [head], {"Head": 0}
    for side in ("Left", "Right"):
        fill = {"Side": side, "s": side[0].lower(), "S": side[0]}
        stem = first.format(**fill)
        for joint, name in zip(("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand"), (
                stem, *(_like(first, REST[rig][k], fill) for k in (0, 1)), arm.format(**fill),
                *(_like(first, REST[rig][k], fill) for k in (2, 3))), strict=True):
            expected[f"{side}{joint}"] = len(names)
            names.append(name)
    assert match_joints(names, range(len(names)), "rig") == expected
    assert set(REQUIRED) == set(expected)


def _like(pattern: str, name: str, fill: dict[str, str]) -> str:
    for old in ("UpLeg", "thigh_", "Thigh", "UpperLeg", "thigh"):
        if old in pattern:
            return pattern.replace(old, name).format(**fill)
    raise AssertionError(pattern)


def test_unknown_names_are_listed_and_can_be_given(tmp_path: Path) -> None:
    names = [f"bone{i}" for i in range(len(REQUIRED))]
    with pytest.raises(InputError, match="no Head, LeftUpLeg.*bone0, bone1.*\n.*--joints"):
        match_joints(names, range(len(names)), "rig")
    given = tmp_path / "joints.json"
    given.write_text(json.dumps(dict(zip(REQUIRED, names, strict=True))))
    assert match_joints(names, range(len(names)), "rig", given) == {n: i for i, n in enumerate(REQUIRED)}
    wrongs = (({"Tail": "bone1"}, "unknown joint"), ({"Head": "bone99"}, "bone99"), ([1], "object"))
    for wrong, text in wrongs:
        given.write_text(json.dumps(wrong))
        with pytest.raises(InputError, match=text):
            match_joints(names, range(len(names)), "rig", given)


def test_training_and_novel_poses_never_show_the_same_moment(path: Path) -> None:
    character = Character(path)
    spans = choose_spans(character, None, None)
    assert [span.animation.name for span in spans] == ["walk", "raise"]
    assert [s.animation.name for s in choose_spans(character, "raise", None)] == ["raise", "walk"]
    assert [s.animation.name for s in choose_spans(character, None, "walk")] == ["raise", "walk"]
    first, second = choose_spans(character, "walk", "walk")
    assert first.end <= second.start and second.end == 2
    with pytest.raises(InputError, match="--animation.*'run'.*raise, walk"):
        choose_spans(character, "run", None)



WRONG: dict[str, Callable[[dict[str, Any]], Any]] = {
    "a cycle": lambda j: j["nodes"][5].update(children=[1]),
    "two parents": lambda j: j["nodes"][0]["children"].append(3),
    "no such node": lambda j: j["nodes"][0]["children"].append(99),
    "no such mesh": lambda j: j["nodes"][-1].update(mesh=3),
    "no such skin": lambda j: j["nodes"][-1].update(skin=3),
    "no skin": lambda j: j["nodes"][-1].pop("skin"),
    "no such joint": lambda j: j["skins"][0]["joints"].append(77),
    "fewer matrices": lambda j: j["skins"][0]["joints"].append(0),
    "no such accessor": lambda j: j["meshes"][0]["primitives"][0]["attributes"].update(POSITION=99),
    "wrong type": lambda j: j["meshes"][0]["primitives"][0]["attributes"].update(POSITION=1),
    "no weights": lambda j: j["meshes"][0]["primitives"][0]["attributes"].pop("WEIGHTS_0"),
    "a huge count": lambda j: j["accessors"][0].update(count=2**31 - 1),
    "a huge count without data": lambda j: j["accessors"][0].update(count=2**31 - 1, bufferView=None),
    "a long view": lambda j: j["bufferViews"][0].update(byteLength=2**30),
    "a far offset": lambda j: j["accessors"][0].update(byteOffset=2**30),
    "text for a number": lambda j: j["accessors"][0].update(count="many"),
    "no quaternion": lambda j: j["nodes"][3].update(rotation=[0, 0, 0, 0]),
    "not finite": lambda j: j["nodes"][3].update(translation=[0, float("nan"), 0]),
    "no animation": lambda j: j.pop("animations"),
    "an unknown interpolation": lambda j: j["animations"][0]["samplers"][0].update(interpolation="CUBE"),
    "Draco": lambda j: j.update(extensionsRequired=["KHR_draco_mesh_compression"]),
    "version 1": lambda j: j["asset"].update(version="1.0"),
    "no image": lambda j: j["images"][0].update(bufferView=0),
    "a string for all": lambda j: j.update(nodes="nodes"),
    "points": lambda j: j["meshes"][0]["primitives"][0].update(mode=0),
    "compressed wrongly": lambda j: j["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {
        "buffer": 0, "byteLength": 64, "byteStride": 12, "count": j["accessors"][0]["count"],
        "mode": "ATTRIBUTES"}}),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_refused(name: str, tmp_path: Path) -> None:
    glb = boxes()
    WRONG[name](glb.json)
    with pytest.raises(InputError, match=r"boxes\.glb"):
        Character(glb.write(tmp_path / "boxes.glb"))


def test_a_damaged_file_is_refused_or_read_but_never_crashes(path: Path) -> None:
    data = path.read_bytes()
    random = np.random.default_rng(0)
    for size in (0, 3, 4, 19, 40, 2000, len(data) - 1):
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            Character(path)
    for _ in range(150):
        spoiled = bytearray(data)
        for place in random.integers(0, len(data), 8):
            spoiled[place] = random.integers(256)
        path.write_bytes(bytes(spoiled))
        try:
            character = Character(path)
            character.vertices(character.world(character.animations[0], np.array([0.5])))
        except InputError:
            pass


def test_wrong_values_anywhere_in_the_json_are_refused_or_read(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    whole = boxes()
    places = list(_places(whole.json))
    for _ in range(250):
        glb = copy.deepcopy(whole)
        *way, last = places[random.integers(len(places))]
        where: Any = glb.json
        for key in way:
            where = where[key]
        where[last] = [None, -1, 10**12, 1e300, "x", [], {}, 0, True][random.integers(9)]
        try:
            character = Character(glb.write(tmp_path / "boxes.glb"))
            character.vertices(character.world(character.animations[0], np.array([0.5])))
        except InputError:
            pass


def _places(value: Any, way: tuple = ()) -> Any:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*way, key)
        yield from _places(inner, (*way, key))
