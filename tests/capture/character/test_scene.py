"""The character in the studio, and the capture as a whole."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigged_character import boxes

from ndf_mi import variants
from ndf_mi.capture.camera import Camera, look_at
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.check import problems
from ndf_mi.capture.synthesise import plan
from ndf_mi.capture.synthesise.character import make
from ndf_mi.capture.synthesise.character.make import Source, synthesise_character
from ndf_mi.capture.synthesise.layers import Layer, Picture
from ndf_mi.capture.synthesise.studio import Studio
from ndf_mi.errors import InputError

variants.use()

SQUARE = np.array([[-1.0, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
POSE = look_at(np.array([0, 1.0, 4]), np.array([0, 1.0, 0]))
CAMERA = Camera("front", 32, 32, 60.0, 60.0, 16.0, 16.0, POSE)


def square(picture: Picture) -> Layer:
    return Layer("square", "cloth", FACES, SQUARE, np.ones((4, 1)), np.ones((4, 3)), uv=UV, picture=picture)


def test_a_picture_is_upright_and_its_holes_show_what_is_behind() -> None:
    colour = np.zeros((2, 2, 3), np.float32)
    colour[0] = 0.8, 0.1, 0.1  # the upper half
    colour[1] = 0.1, 0.1, 0.8
    studio = Studio([square(Picture(colour, "clamp"))], 64, "flat")
    studio.pose([SQUARE.astype(np.float32)])
    radiance, coverage = studio.render(CAMERA, 0)
    np.testing.assert_allclose(radiance[3, 16], colour[0, 0], atol=0.01)
    np.testing.assert_allclose(radiance[28, 16], colour[1, 0], atol=0.01)
    assert coverage[3:29, 3:29].min() == 1
    opaque = np.ones((2, 8), np.float32)
    opaque[:, :4] = 0
    holed = square(Picture(np.tile(colour[:1, :1], (2, 8, 1)), "clamp", opaque))
    behind = replace(square(Picture(np.tile(colour[1:, :1], (2, 8, 1)))), rest=SQUARE - [0, 0, 0.5])
    for light in ("flat", "studio"):
        studio = Studio([holed], 64, light)
        studio.pose([SQUARE.astype(np.float32)])
        coverage = studio.render(CAMERA, 0)[1]
        assert coverage[16, :14].max() == 0 and coverage[16, 19:29].min() == 1
    studio = Studio([holed, behind], 64, "flat")
    studio.pose([SQUARE.astype(np.float32), (SQUARE - [0, 0, 0.5]).astype(np.float32)])
    radiance, coverage = studio.render(CAMERA, 0)
    np.testing.assert_allclose(radiance[16, 8], colour[1, 0], atol=0.01)
    np.testing.assert_allclose(radiance[16, 24], colour[0, 0], atol=0.01)


def test_given_normals_shade_instead_of_those_of_triangles() -> None:
    grey = square(Picture(np.full((2, 2, 3), 0.5, np.float32)))
    shades = []
    for turned in (None, np.tile([0.0, 1, 0], (4, 1)), np.tile([0.0, 0, 1], (4, 1))):
        studio = Studio([grey], 64)
        studio.pose([SQUARE.astype(np.float32)], normals=None if turned is None else [turned])
        shades.append(studio.render(CAMERA, 0)[0][8:24, 8:24].mean())
    assert abs(shades[0] - shades[2]) < 1e-4 and abs(shades[1] - shades[0]) > 0.02


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Source, dict]:
    folder = tmp_path_factory.mktemp("character")
    source = Source(boxes().write(folder / "boxes.glb"))
    return folder / "capture", source, synthesise_character(folder / "capture", source, plan.SIZES["tiny"])


def test_the_capture_is_sound_and_the_body_is_in_its_masks(made: tuple[Path, Source, dict]) -> None:
    out, _, figures = made
    assert problems(out) == []
    capture = Capture.read(out)
    assert figures["training"] == "walk" and figures["novel"] == "raise"
    assert figures == json.loads((out / "fit.json").read_text())
    assert figures["iou"] > 0.5 and figures["joints_mean_mm"] < 60
    # Hips over the origin, soles on the ground.
    assert abs(capture.poses.vertices[..., 1].min()) < 0.06
    assert np.abs(capture.poses.vertices[..., [0, 2]].mean(axis=1)).max() < 0.15
    # The picture is red and green without blue: so are the images.
    camera, frame = next(iter(capture.splits["train"]))
    image, mask = capture.image(camera, frame), capture.mask(camera, frame)
    assert image[mask][:, 0].mean() > 2 * image[mask][:, 2].mean()


def test_an_interrupted_capture_goes_on_and_another_file_is_refused(made: tuple[Path, Source, dict],
                                                                    tmp_path: Path,
                                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    out, source, figures = made
    calls: list[tuple[int, int]] = []
    again = synthesise_character(out, source, plan.SIZES["tiny"], progress=lambda *n: calls.append(n))
    assert again == figures and calls == [(1, 1)]
    # Without capture.json and an image, that image alone is rendered again, and is the same.
    capture = Capture.read(out)
    monkeypatch.setattr(make, "fit", lambda *_: (capture.body, capture.poses))
    missing = next(out.glob("images/*/*.png"))
    before = missing.read_bytes()
    missing.unlink()
    (out / "capture.json").unlink()
    calls.clear()
    synthesise_character(out, source, plan.SIZES["tiny"], progress=lambda *n: calls.append(n))
    assert calls == [(12, 13), (13, 13)] and missing.read_bytes() == before and problems(out) == []
    assert "character" in json.loads((out / "synthesis.json").read_text())
    glb = boxes()
    glb.json["asset"]["generator"] = "another"
    other = Source(glb.write(tmp_path / "other.glb"))
    with pytest.raises(InputError, match="other settings"):
        synthesise_character(out, other, plan.SIZES["tiny"])
