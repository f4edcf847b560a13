"""Pictures of another program: what is accepted, how it is read, and what is refused before anything is
measured.
"""

from __future__ import annotations

import json

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.methods.base import Budget, expect_views
from ndf_mi.methods.images import Images

VIEW = ("n0", 5)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "theirs" / "n0").mkdir(parents=True)
    return tmp_path / "theirs"


def pixels(capture, channels: int, dtype=np.uint8) -> np.ndarray:
    camera = capture.cameras["n0"]
    values = np.random.default_rng(0).integers(
        0, np.iinfo(dtype).max, (camera.h, camera.w, channels), dtype, endpoint=True
    )
    return values[..., 0] if channels == 1 else values


def loaded(folder, capture) -> Images:
    method = Images()
    method.load(folder, capture)
    return method


@pytest.mark.parametrize("name", ["000005.png", "5.png"])
def test_a_picture_is_shown_as_it_is(folder, capture, name):
    values = pixels(capture, 3)
    Image.fromarray(values).save(folder / "n0" / name)
    image = loaded(folder, capture).render(capture.cameras["n0"], 5)
    assert image.dtype == np.float32
    np.testing.assert_array_equal(np.round(image * 255), values)


def test_sixteen_bits_keep_their_precision(folder, capture):
    values = pixels(capture, 3, np.uint16)
    mi.Bitmap(values).write(str(folder / "n0" / "5.png"))
    np.testing.assert_array_equal(
        np.round(loaded(folder, capture).render(capture.cameras["n0"], 5) * 65535), values
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_becomes_colour(folder, capture, dtype):
    values = pixels(capture, 1, dtype)
    Image.fromarray(values).save(folder / "n0" / "5.png")
    image = loaded(folder, capture).render(capture.cameras["n0"], 5)
    for channel in range(3):
        np.testing.assert_array_equal(np.round(image[..., channel] * np.iinfo(dtype).max), values)


def test_a_palette_is_resolved(folder, capture):
    camera = capture.cameras["n0"]
    Image.new("RGB", (camera.w, camera.h), (200, 10, 60)).quantize(4).save(folder / "n0" / "5.png")
    image = loaded(folder, capture).render(camera, 5)
    np.testing.assert_allclose(image.mean((0, 1)) * 255, (200, 10, 60), atol=1)


def test_alpha_is_composited_over_the_background_in_linear_light(folder, capture):
    values = pixels(capture, 4)
    values[0, 0, 3], values[0, 1, 3] = 0, 255
    Image.fromarray(values).save(folder / "n0" / "5.png")
    image = loaded(folder, capture).render(capture.cameras["n0"], 5)
    colour, alpha = values[..., :3] / 255.0, values[..., 3:] / 255.0
    expected = linear_to_srgb(
        alpha * srgb_to_linear(colour) + (1 - alpha) * srgb_to_linear(capture.background.astype(np.float64))
    )
    np.testing.assert_allclose(image, expected, atol=1e-5)
    np.testing.assert_allclose(image[0, 0], capture.background, atol=1e-6)
    np.testing.assert_array_equal(np.round(image[0, 1] * 255), values[0, 1, :3])


def test_missing_pictures_are_listed_before_anything_is_rendered(folder, capture):
    Image.fromarray(pixels(capture, 3)).save(folder / "n0" / "5.png")
    method = loaded(folder, capture)
    expect_views(method, [VIEW])
    with pytest.raises(InputError) as error:
        expect_views(method, [VIEW, ("n0", 7), ("n1", 7)])
    assert all(
        word in str(error.value) for word in ("2 of 3", "n0/000007.png", "n1/000007.png")
    ) and "000005" not in str(error.value)
    with pytest.raises(InputError, match="n1/000007.png"):
        method.render(capture.cameras["n1"], 7)


def test_what_is_no_folder_of_pictures_is_refused(folder, capture):
    with pytest.raises(InputError, match="nowhere"):
        loaded(folder / "nowhere", capture)
    with pytest.raises(InputError, match="CAMERA/FRAME.png.*n0"):
        (folder / "n0" / "note.txt").write_text("nothing here")
        try:
            loaded(folder, capture)
        except InputError as error:
            raise InputError("", "", str(error).replace("\n", " ")) from error
    file = folder / "n0" / "5.png"
    Image.new("RGB", (7, 9)).save(file)
    with pytest.raises(InputError, match="5.png.*7 x 9.*48 x 48"):
        loaded(folder, capture)
    file.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="5.png.*PNG"):
        loaded(folder, capture)
    Image.fromarray(pixels(capture, 3)).save(file)
    cut = file.read_bytes()[:2000]
    file.write_bytes(cut)
    with pytest.raises(InputError, match="5.png"):
        loaded(folder, capture).render(capture.cameras["n0"], 5)
    Image.fromarray(pixels(capture, 3)).save(file)
    Image.fromarray(pixels(capture, 3)).save(folder / "n0" / "000005.png")
    with pytest.raises(InputError, match="000005.png.*5.png"):
        loaded(folder, capture)


def test_it_cannot_be_trained(capture):
    with pytest.raises(InputError, match="images:FOLDER"):
        Images().fit(capture, Budget())


def test_label_and_metadata_come_from_the_folder(folder, capture):
    Image.fromarray(pixels(capture, 3)).save(folder / "n0" / "5.png")
    method = loaded(folder, capture)
    assert (
        method.label == "theirs"
        and method.metadata()["pictures"] == 1
        and str(folder) in method.metadata()["note"]
    )
    (folder / "metadata.json").write_text(
        json.dumps({"label": "Splats", "seconds": 12.5, "note": "By splats 1.2."})
    )
    method = loaded(folder, capture)
    assert (
        method.label == "Splats"
        and method.metadata()["seconds"] == 12.5
        and method.metadata()["note"] == "By splats 1.2."
    )
    for wrong in ("[1]", '{"seconds": "long"}', '{"label": 3}', "{"):
        (folder / "metadata.json").write_text(wrong)
        with pytest.raises(InputError, match="metadata.json"):
            loaded(folder, capture)


def test_its_cache_key_follows_the_contents(folder, capture):
    file = folder / "n0" / "5.png"
    Image.fromarray(pixels(capture, 3)).save(file)
    before = loaded(folder, capture).cache_key()
    assert loaded(folder, capture).cache_key() == before
    file.rename(file.with_name("000005.png"))
    assert loaded(folder, capture).cache_key() == before
    Image.fromarray(255 - pixels(capture, 3)).save(file.with_name("000005.png"))
    assert loaded(folder, capture).cache_key() != before
