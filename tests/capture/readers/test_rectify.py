"""Undistortion against OpenCV's, shrinking against means by hand, and the world's turn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.readers.fits import Fits
from ndf_mi.capture.readers.rectify import Rectifier, read_labels, read_rgb
from ndf_mi.errors import InputError


def test_undistorts_as_opencv() -> None:
    cv2 = pytest.importorskip("cv2")
    rows, columns = np.mgrid[0:80, 0:100]
    waves = [np.sin(columns / 9 + i) * np.cos(rows / 7 - i) for i in range(3)]
    image = np.round(127 + 100 * np.stack(waves, -1)).astype(np.uint8)
    matrix = np.array([[90.0, 0, 48.2], [0, 90, 41.7], [0, 0, 1]])
    expected = cv2.undistort(image, matrix, np.array([-0.3, 0.1, 0.003, -0.002, 0.01]))
    camera = Camera("a", 100, 80, 90, 90, 48.7, 42.2, np.eye(4), (-0.3, 0.1, 0.01, 0.003, -0.002))
    found = Rectifier(camera, 1.0).image(image)
    # OpenCV's positions are fractions of 1/32 pixel, over which these waves change by up to half a step.
    assert np.abs(found.astype(int) - expected)[1:-1, 1:-1].max() <= 2
    mask = image[..., 0] > 127
    expected_mask = (
        cv2.undistort(mask.astype(np.uint8), matrix, np.array([-0.3, 0.1, 0.003, -0.002, 0.01])) > 0
    )
    assert (Rectifier(camera, 1.0).mask(mask) == expected_mask).mean() > 0.98


def test_halves_by_area_and_masks_to_the_nearest() -> None:
    camera = Camera("a", 4, 3, 10, 10, 2.5, 1.5, np.eye(4))
    image = np.zeros((3, 4, 3), np.uint8)
    image[:, :, 1] = [[0, 4, 10, 10], [8, 8, 10, 30], [255, 255, 255, 255]]
    mask = np.array([[1, 0, 0, 1], [0, 0, 1, 1], [1, 1, 1, 1]], bool)
    half = Rectifier(camera, 0.5)
    # The third row is half a pixel and is cut off: (0 + 4 + 8 + 8) / 4 and (10 + 10 + 10 + 30) / 4.
    assert half.image(image)[..., 1].tolist() == [[5, 15]] and half.image(image).shape == (1, 2, 3)
    assert half.mask(mask).tolist() == [[True, False]]
    camera_of_half = half.camera
    assert (camera_of_half.w, camera_of_half.h, camera_of_half.fl_x) == (2, 1, 5)
    assert (camera_of_half.cx, camera_of_half.cy) == (1.25, 0.75)
    assert (Rectifier(camera, 1.0).image(image) == image).all()


def test_reading(tmp_path: Path) -> None:
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    Image.fromarray(image).save(tmp_path / "a.png")
    assert (read_rgb(tmp_path / "a.png", (4, 4)) == image).all()
    assert read_rgb(tmp_path / "a.png", (8, 6)).shape == (6, 8, 3)
    labels = np.array([[0, 1], [19, 200]], np.uint8)
    for mode in ("L", "P", "RGB", "RGBA", "LA"):
        picture = Image.fromarray(labels)
        if mode == "P":
            picture.putpalette([0, 0, 0] * 256)
        else:
            picture = picture.convert(mode)
        picture.save(tmp_path / "m.png")
        assert read_labels(tmp_path / "m.png", (2, 2), 0).tolist() == [[False, True], [True, True]]
        assert read_labels(tmp_path / "m.png", (2, 2), 127).tolist() == [[False, False], [False, True]]
    wide = read_labels(tmp_path / "m.png", (4, 2), 0)
    assert wide.tolist() == [[False, False, True, True], [True] * 4]
    Image.fromarray(labels > 0).save(tmp_path / "bits.png")
    assert read_labels(tmp_path / "bits.png", (2, 2), 127).tolist() == [[False, True], [True, True]]
    (tmp_path / "text.jpg").write_text("no image")
    with pytest.raises(InputError, match=r"text.jpg: found a file that cannot be decoded"):
        read_rgb(tmp_path / "text.jpg", (2, 2))


@pytest.mark.parametrize("up", [[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]])
def test_y_comes_up(up: list[int]) -> None:
    """Whichever axis is up: the performer's own, which leans a little, is brought to y by quarters of a
    turn.
    """
    to_up, _ = Rotation.align_vectors([up], [[0, 1, 0]])
    leaning = Rotation.from_euler("xyz", [0.3, 1.1, -0.2]).as_matrix()
    root = Rotation.from_matrix(to_up.as_matrix() @ leaning).as_rotvec()[None]
    fits = Fits(np.zeros((1, 24, 3)), root, np.array([[1.0, 2, 3]]), np.zeros(10))
    turn = fits.upright()
    np.testing.assert_allclose(turn @ up, [0, 1, 0], atol=1e-12)
    assert set(np.abs(turn).round(12).ravel()) == {0, 1} and np.linalg.det(turn) == pytest.approx(1)
    turned = fits.turned(turn)
    point = np.array([0.3, -0.5, 0.7])
    before = Rotation.from_rotvec(root[0]).apply(point) + [1, 2, 3]
    after = Rotation.from_rotvec(turned.root_rotation[0]).apply(point) + turned.translation[0]
    np.testing.assert_allclose(after, turn @ before, atol=1e-12)
