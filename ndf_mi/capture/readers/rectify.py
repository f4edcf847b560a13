"""Resamples images and masks to a pinhole camera with square pixels and a smaller image."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.images import opened_image, source_positions

_KINDS = (("JPEG", "PNG"), "a whole image, JPEG or PNG")


class Rectifier:
    """Undistorts, then shrinks images and masks, over black.

    They are undistorted at full size, images bilinearly and masks from the nearest pixel. Images are then
    averaged over the area of each smaller pixel; of masks the top left pixel is taken, as in ZJU-MoCap's
    protocol. The same resampling makes pixels square, with the mean focal length, so that nothing is
    resampled when the capture is read. Fractions of a pixel at the right and bottom edge are cut off.

    Args:
        camera: the calibrated camera, of the size of the given images.
        scale: size of the new image relative to the old one, in (0, 1].

    Attributes:
        camera: the pinhole camera of the smaller size.
    """

    def __init__(self, camera: Camera, scale: float) -> None:
        self._full, self._scale = (camera.w, camera.h), scale
        self.camera = shrunk(camera, scale)
        self._at = None if camera.is_pinhole else source_positions(camera)

    def image(self, image: np.ndarray) -> np.ndarray:
        """(h, w, 3) uint8 sRGB, from the calibrated camera to the pinhole camera."""
        if self._at is not None:
            channels = [map_coordinates(image[..., i], self._at, np.float32, order=1) for i in range(3)]
            image = np.round(np.stack(channels, axis=-1)).astype(np.uint8)
        if self._scale == 1:
            return image
        size = (self.camera.w, self.camera.h)
        part = (0.0, 0.0, min(size[0] / self._scale, self._full[0]),
                min(size[1] / self._scale, self._full[1]))
        return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX, part))

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """(h, w) bool, from the calibrated camera to the pinhole camera."""
        if self._at is not None:
            mask = map_coordinates(mask.astype(np.uint8), self._at, order=0) > 0
        sides = (self.camera.h, self.camera.w)
        rows, columns = ((np.arange(n) / self._scale + 1e-6).astype(int) for n in sides)
        return mask[np.ix_(rows, columns)]


def shrunk(camera: Camera, scale: float) -> Camera:
    """The pinhole camera at the same place, of ``scale`` times the size, rounded down."""
    w, h = (max(1, int(side * scale + 1e-9)) for side in (camera.w, camera.h))
    ideal = camera.pinhole()
    return replace(ideal, w=w, h=h, fl_x=ideal.fl_x * scale, fl_y=ideal.fl_y * scale, cx=ideal.cx * scale,
                   cy=ideal.cy * scale)


def size_of(path: Path) -> tuple[int, int]:
    """w, h of an image file; errors as `read_rgb`."""
    with opened_image(path, *_KINDS) as image:
        return image.size


def read_rgb(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) uint8 of an image file, resized bilinearly to ``size`` (w, h) if it has another.

    Raises:
        InputError: the file is missing, truncated or not an image.
    """
    with opened_image(path, *_KINDS) as image:
        pixels = image.convert("RGB")
        return np.asarray(pixels if pixels.size == size else pixels.resize(size, Image.Resampling.BILINEAR))


def read_labels(path: Path, size: tuple[int, int], above: int) -> np.ndarray:
    """(h, w) bool of a mask file: whether a channel is above ``above``; resized by nearest pixels. Errors as
    `read_rgb`."""
    with opened_image(path, *_KINDS) as image:
        mask = np.asarray(image)
    if mask.ndim == 3:
        mask = mask[..., :1] if mask.shape[2] == 2 else mask[..., :3]  # without opacity
        mask = mask.max(axis=2)
    mask = mask if mask.dtype == bool else mask > above
    rows, columns = (np.arange(n) * m // n for n, m in zip(size[::-1], mask.shape, strict=True))
    return mask[np.ix_(rows, columns)]
