"""The reader gives back what was written, and each kind of bad input is named by file, key, found and
expected.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.check import problems, summary
from ndf_mi.capture.document import Imported, parse_document
from ndf_mi.capture.images import is_soft, write_mask
from ndf_mi.errors import InputError


def edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    file = folder / "capture.json"
    value = json.loads(file.read_text())
    change(value)
    file.write_text(json.dumps(value))


def save_npz(file: Path, **changes: np.ndarray | None) -> None:
    with np.load(file) as old:
        arrays = {**old, **changes}
    np.savez(file, **{k: v for k, v in arrays.items() if v is not None})


def with_nan(file: Path) -> None:
    pose = np.load(file)["pose"]
    pose[1] = np.nan
    save_npz(file, pose=pose)


def truncate(file: Path) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 2 // 3])


def test_a_sound_capture_comes_back_as_written(box_capture: Path) -> None:
    assert problems(box_capture) == []
    capture = Capture.read(box_capture)
    assert capture.name == "box"
    np.testing.assert_allclose(capture.background, [0.25, 0.5, 0.75])
    assert capture.splits["train"].cameras == ("a", "b") and capture.splits["train"].frames == (0, 1)
    assert len(capture.splits["train"]) == 4
    mask = capture.mask("b", 1)
    image = capture.image("b", 1)
    assert image.shape == (48, 32, 3) and image.dtype == np.float32 and mask.dtype == bool
    np.testing.assert_allclose(image[mask].mean(0), [0.9, 0.2, 0.1], atol=0.51 / 255)
    np.testing.assert_allclose(image[~mask].mean(0), [0.25, 0.5, 0.75], atol=0.51 / 255)
    assert "train: 2 cameras x 2 frames = 4 images" in summary(capture)


def test_a_distorted_camera_comes_out_pinhole_with_its_mask_where_the_body_is(
    box_capture: Path, expected_silhouette: Callable[[Camera, np.ndarray], np.ndarray]
) -> None:
    capture = Capture.read(box_capture)
    assert capture.cameras["c"].is_pinhole
    expected = expected_silhouette(capture.cameras["c"], capture.poses.vertices[1])
    mask = capture.mask("c", 1)
    assert (mask & expected).sum() / (mask | expected).sum() > 0.95
    image = capture.image("c", 1)
    np.testing.assert_allclose(image[mask & expected].mean(0), [0.9, 0.2, 0.1], atol=0.05)


def test_mattes_keep_their_values_and_their_silhouette_is_where_they_are_half_covered(
    box_capture: Path, expected_silhouette: Callable[[Camera, np.ndarray], np.ndarray]
) -> None:
    """The share of each pixel that a box covers, counted over 8 x 8 points; camera c has distortion."""
    capture = Capture.read(box_capture)
    covered = {}
    for name in ("b", "c"):
        camera = capture.cameras[name]
        fine = replace(camera, w=8 * camera.w, h=8 * camera.h, fl_x=8 * camera.fl_x, fl_y=8 * camera.fl_y,
                       cx=8 * camera.cx, cy=8 * camera.cy)
        inside = expected_silhouette(fine, capture.poses.vertices[1])
        covered[name] = inside.reshape(camera.h, 8, camera.w, 8).mean((1, 3))
    for name in ("b", "c"):
        write_mask(box_capture / f"masks/{name}/000001.png", covered[name])
    matte = capture.matte("b", 1)
    assert matte.dtype == np.float32 and 0.3 < matte[(matte > 0) & (matte < 1)].mean() < 0.7
    np.testing.assert_allclose(matte, covered["b"], atol=0.51 / 255)
    np.testing.assert_array_equal(capture.mask("b", 1), matte >= 0.5)
    resampled = capture.matte("c", 1)
    assert set(np.unique(capture.matte("b", 0))) == {0, 1}
    # This matte was made without the distortion and lies elsewhere after it, but stays soft.
    assert is_soft(resampled) and (capture.mask("c", 1) == (resampled >= 0.5)).all()
    assert not problems(box_capture)


def test_the_digest_follows_the_contents(box_capture: Path) -> None:
    before = Capture.read(box_capture).digest
    assert before == Capture.read(box_capture).digest
    edit(box_capture, lambda value: value.update(name="other"))
    after = Capture.read(box_capture).digest
    assert after != before and len(after) == 64


IMPORTED = {"layout": "zju", "subject": "377", "cameras": ["a", "b", "c", "d"], "frames": 5,
            "test_frames": 30, "scale": 0.5}

BAD_DOCUMENTS: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "newer version": (lambda v: v.update(version=2), "version: found 2; expected 1"),
    "other format": (lambda v: v.update(format="zju"), "format"),
    "feet": (lambda v: v.update(units="ft"), "units"),
    "no name": (lambda v: v.pop("name"), "name: found nothing"),
    "background of 8 bits": (lambda v: v.update(background=[255, 0, 0]), r"background\[0\]: found 255"),
    "pattern without a frame": (lambda v: v.update(image_pattern="images/{camera}.png"), "image_pattern"),
    "pattern that climbs out": (lambda v: v.update(mask_pattern="../{camera}/{frame}.png"), "mask_pattern"),
    "no cameras": (lambda v: v.update(cameras=[]), "cameras"),
    "camera twice": (lambda v: v["cameras"].append(v["cameras"][0]), r"cameras\[3\].name"),
    "camera without a focal length": (lambda v: v["cameras"][1].pop("fl_x"),
                                      r"cameras\[1\].fl_x: found nothing"),
    "width that is not whole": (lambda v: v["cameras"][0].update(w=40.5), r"cameras\[0\].w"),
    "distortion as text": (lambda v: v["cameras"][0].update(k1="a"), r"cameras\[0\].k1"),
    "matrix of another shape": (lambda v: v["cameras"][0].update(transform_matrix=[[1]]), "transform_matrix"),
    "matrix with a scale": (
        lambda v: v["cameras"][0].update(transform_matrix=np.diag([2.0, 2, 2, 1]).tolist()),
        "rigid motion",
    ),
    "no training split": (lambda v: v["splits"].pop("train"), "splits.train"),
    "unknown split": (lambda v: v["splits"].update(test={}), "splits.test"),
    "unknown camera in a split": (lambda v: v["splits"]["train"].update(cameras=["z"]),
                                  'found "z"; expected a camera'),
    "frame that poses lack": (lambda v: v["splits"]["train"].update(frames=[0, 3]),
                              "3, which poses.npz lacks"),
    "frame twice": (lambda v: v["splits"]["train"].update(frames=[0, 0]), "splits.train.frames"),
    "lighting that is not there": (lambda v: v.update(lighting={"scene": "l.xml"}), "lighting.scene"),
    "imported as text": (lambda v: v.update(imported="zju"), 'imported: found "zju"; expected an object'),
    "imported without a subject": (lambda v: v.update(imported={**IMPORTED, "subject": None}),
                                   "imported.subject: found nothing"),
    "imported cameras by number": (lambda v: v.update(imported={**IMPORTED, "cameras": [1]}),
                                   "imported.cameras"),
    "imported every 0th frame": (lambda v: v.update(imported={**IMPORTED, "frames": 0}),
                                 "imported.frames: found 0"),
    "imported twice as large": (lambda v: v.update(imported={**IMPORTED, "scale": 2}),
                                "imported.scale: found 2"),
    "a number of 400 digits": (lambda v: v["cameras"][0].update(fl_x=10**400), r"cameras\[0\].fl_x"),
    "a matrix of 400 digits": (lambda v: v["cameras"][0]["transform_matrix"][0].__setitem__(0, 10**400),
                               "transform_matrix"),
}


def test_what_it_was_imported_from_is_kept_and_optional(box_capture: Path) -> None:
    assert Capture.read(box_capture).imported is None
    edit(box_capture, lambda d: d.update(imported=IMPORTED))
    assert Capture.read(box_capture).imported == Imported("zju", "377", ("a", "b", "c", "d"), 5, 30, 0.5)
    document, _ = parse_document(box_capture)
    assert document.as_json()["imported"] == IMPORTED


@pytest.mark.parametrize("case", BAD_DOCUMENTS)
def test_bad_documents_are_named(box_capture: Path, case: str) -> None:
    change, message = BAD_DOCUMENTS[case]
    edit(box_capture, change)
    with pytest.raises(InputError, match=message) as raised:
        Capture.read(box_capture)
    assert "capture.json" in raised.value.where
    assert any(str(found) == str(raised.value) for found in problems(box_capture))


def resize(file: Path) -> None:
    Image.open(file).resize((20, 20)).save(file)


def grey(file: Path) -> None:
    Image.open(file).convert("L").save(file)


def compress(file: Path) -> None:
    lossy = io.BytesIO()
    Image.open(file).save(lossy, "JPEG", quality=80)
    Image.open(lossy).save(file)


IMAGE, MASK = "images/b/000001.png", "masks/b/000001.png"
BAD_FILES: dict[str, tuple[str, Callable[[Path], Any], str]] = {
    "no description": ("capture.json", Path.unlink, "no such file"),
    "half a description": ("capture.json", truncate, "cannot be read as JSON"),
    "a description nested too deep": ("capture.json", lambda f: f.write_text("[" * 100_000),
                                      "cannot be read as JSON"),
    "a description that is a list": ("capture.json", lambda f: f.write_text("[]"), "a JSON object"),
    "no body": ("body.npz", Path.unlink, "body.npz"),
    "half a body": ("body.npz", truncate, "body.npz"),
    "a body without UVs": ("body.npz", lambda f: save_npz(f, uv=None), "uv"),
    "faces out of range": ("body.npz", lambda f: save_npz(f, faces=np.full((12, 3), -1, np.int32)),
                           "body.npz|faces"),
    "no poses": ("poses.npz", Path.unlink, "poses.npz"),
    "NaN in a pose": ("poses.npz", with_nan, "poses.npz: pose"),
    "vertices of another shape": ("poses.npz", lambda f: save_npz(f, vertices=np.zeros((3, 2))),
                                  "poses.npz: vertices"),
    "no image": (IMAGE, Path.unlink, "no such file"),
    "no mask": (MASK, Path.unlink, "no such file"),
    "half an image": (IMAGE, truncate, "cannot be decoded"),
    "an image that is text": (IMAGE, lambda f: f.write_text("no"), "cannot be decoded"),
    "an image of another size": (IMAGE, resize, "20 x 20 pixels; expected 32 x 48"),
    "a grey image": (IMAGE, grey, "mode L; expected 8-bit RGB"),
    "an empty mask": (MASK, lambda f: Image.new("L", (32, 48)).save(f), "an empty mask"),
    "a mask of 0 and 1": (MASK, lambda f: Image.open(f).point(lambda v: v // 255).save(f),
                          r"a mask of 0 and 1; expected 255(.|\n)*Multiply it by 255\."),
    "a mask of labels": (MASK, lambda f: Image.linear_gradient("L").resize((32, 48)).point(
        lambda v: v // 64).save(f), "a mask with 4 different values, the largest 3"),
    "a mask after lossy compression": (MASK, compress, "lossy compression"),
    "a colour mask": (MASK, lambda f: Image.new("RGB", (32, 48)).save(f),
                      "mode RGB; expected 8-bit, one channel"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_named(box_capture: Path, case: str) -> None:
    name, damage, message = BAD_FILES[case]
    damage(box_capture / name)
    with pytest.raises(InputError, match=message) as raised:
        capture = Capture.read(box_capture)
        capture.image("b", 1)
        capture.mask("b", 1)
    assert name in raised.value.where
    assert any(name in found.where for found in problems(box_capture))


def test_check_lists_every_fault_at_once(box_capture: Path) -> None:
    edit(box_capture,
         lambda v: (v.update(units="ft"), v["cameras"][0].update(fl_x=-1), v["splits"].update(x={})))
    (box_capture / "body.npz").unlink()
    text = "\n".join(map(str, problems(box_capture)))
    assert all(key in text for key in ("units", "cameras[0].fl_x", "splits.x", "body.npz"))


def test_check_sees_a_body_off_its_mask_and_a_background_that_is_not_the_one_declared(
    box_capture: Path,
) -> None:
    vertices = np.load(box_capture / "poses.npz")["vertices"]
    save_npz(box_capture / "poses.npz", vertices=vertices + np.float32([1.1, 0, 0]))
    edit(box_capture, lambda v: v.update(background=[0, 0, 0]))
    text = "\n".join(map(str, problems(box_capture)))
    assert "vertices in camera a on the mask" in text
    assert "differ from the background by up to 0.749" in text


def test_cameras_and_frames_that_are_not_there(box_capture: Path) -> None:
    capture = Capture.read(box_capture)
    with pytest.raises(InputError, match="no camera z; expected one of a, b, c"):
        capture.image("z", 0)
    with pytest.raises(InputError, match="no frame 5 of camera b in any split; expected one of 0-1"):
        capture.mask("b", 5)
    with pytest.raises(InputError, match="no such folder"):
        Capture.read(box_capture / "nowhere")


def test_the_command_ends_with_2_and_says_why(box_capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from ndf_mi.commands.capture_check import CaptureCheck

    assert CaptureCheck(box_capture).run() == 0
    assert "box: 3 cameras" in capsys.readouterr().out
    (box_capture / IMAGE).unlink()
    assert CaptureCheck(box_capture).run() == 2
    assert "000001.png: found no such file" in capsys.readouterr().err
