"""Images and masks of a calibrated camera brought to an ideal one: without distortion, with square pixels, smaller."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError


class Rectifier:
    """Undistorts, then shrinks: what `camera` would have seen through an ideal lens, over black.

    Undistorted at full size (images bilinearly, masks to the nearest pixel), then averaged over the area of each smaller pixel; of
    masks the pixel at its top left, as ZJU-MoCap's protocol does. Square pixels of the mean focal length come of the same
    resampling, so that readers of the capture resample nothing.

    Args:
        camera: with its distortion, of the size of the images given.
        scale: size of a pixel before to that after, in (0, 1]; what is left of an image's right and bottom edge is cut off.

    Attributes:
        camera: the ideal camera, of the smaller size.
    """

    def __init__(self, camera: Camera, scale: float) -> None:
        self._full, self._scale = (camera.w, camera.h), scale
        self.camera = shrunk(camera, scale)
        self._at: np.ndarray | None = None
        if not camera.is_pinhole:
            ideal = camera.pinhole()
            rows, columns = np.mgrid[0 : camera.h, 0 : camera.w] + 0.5
            rays = np.stack([(columns - ideal.cx) / ideal.fl_x, (rows - ideal.cy) / ideal.fl_y], axis=-1).reshape(-1, 2)
            seen = camera.distort(rays) * [camera.fl_x, camera.fl_y] + [camera.cx, camera.cy] - 0.5
            self._at = seen.T[::-1].reshape(2, camera.h, camera.w)

    def image(self, image: np.ndarray) -> np.ndarray:
        """(h, w, 3) uint8 sRGB of the camera's size → that of the ideal camera."""
        if self._at is not None:
            channels = [map_coordinates(image[..., i], self._at, np.float32, order=1) for i in range(3)]
            image = np.round(np.stack(channels, axis=-1)).astype(np.uint8)
        if self._scale == 1:
            return image
        size = (self.camera.w, self.camera.h)
        part = (0.0, 0.0, min(size[0] / self._scale, self._full[0]), min(size[1] / self._scale, self._full[1]))
        return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX, part))

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """(h, w) bool of the camera's size → that of the ideal camera."""
        if self._at is not None:
            mask = map_coordinates(mask.astype(np.uint8), self._at, order=0) > 0
        rows, columns = ((np.arange(n) / self._scale + 1e-6).astype(int) for n in (self.camera.h, self.camera.w))
        return mask[np.ix_(rows, columns)]


def shrunk(camera: Camera, scale: float) -> Camera:
    """The ideal camera in this one's place, of ``scale`` times its size, rounded down."""
    w, h = (max(1, int(side * scale + 1e-9)) for side in (camera.w, camera.h))
    ideal = camera.pinhole()
    return replace(ideal, w=w, h=h, fl_x=ideal.fl_x * scale, fl_y=ideal.fl_y * scale, cx=ideal.cx * scale, cy=ideal.cy * scale)


def size_of(path: Path) -> tuple[int, int]:
    """w, h of an image file; errors as `read_rgb`."""
    with _opened(path) as image:
        return image.size


def read_rgb(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) uint8 of an image file, resized to ``size`` (w, h), bilinearly, where it has another.

    Raises:
        InputError: the file is missing, truncated or no image.
    """
    with _opened(path) as image:
        pixels = _loaded(path, image).convert("RGB")
        return np.asarray(pixels if pixels.size == size else pixels.resize(size, Image.Resampling.BILINEAR))


def read_labels(path: Path, size: tuple[int, int], above: int) -> np.ndarray:
    """(h, w) bool of a mask's file: where any channel (or palette index) is larger than ``above``; of another size, the nearest pixel.

    Raises:
        InputError: the file is missing, truncated or no image.
    """
    with _opened(path) as image:
        mask = np.asarray(_loaded(path, image))
    if mask.ndim == 3:
        mask = mask[..., :1] if mask.shape[2] == 2 else mask[..., :3]  # without opacity
        mask = mask.max(axis=2)
    mask = mask if mask.dtype == bool else mask > above
    rows, columns = (np.arange(n) * m // n for n, m in zip(size[::-1], mask.shape, strict=True))
    return mask[np.ix_(rows, columns)]


def _opened(path: Path) -> Image.Image:
    try:
        return Image.open(path, formats=["JPEG", "PNG"])
    except FileNotFoundError:
        raise InputError(path, "no such file", "an image, JPEG or PNG") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(path, f"a file that cannot be decoded ({error})", "an image, JPEG or PNG") from None


def _loaded(path: Path, image: Image.Image) -> Image.Image:
    try:
        image.load()
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise InputError(path, f"a file that cannot be decoded ({error})", "a whole image, JPEG or PNG") from None
    return image
