"""The PNG files of a capture: reads, checks, writes and undistorts 8-bit images and masks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.files import replacing


@contextmanager
def opened_image(path: Path, formats: tuple[str, ...], expected: str) -> Iterator[Image.Image]:
    """An image file; errors while it is decoded become InputErrors, with what is ``expected``."""
    try:
        with Image.open(path, formats=formats) as image:
            yield image
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(path, "no such file", expected) from None
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        raise InputError(path, f"a file that cannot be decoded ({error})", expected) from None


def read_png(path: Path, mode: str, size: tuple[int, int]) -> np.ndarray:
    """Reads an 8-bit PNG of Pillow mode ``RGB`` or ``L`` and of ``size`` (w, h); uint8 (h, w, 3) or (h, w).

    Raises:
        InputError: the file is missing, truncated, not an image, or of another mode or size.
    """
    kind = {"RGB": "8-bit RGB", "L": "8-bit, one channel"}[mode]
    with opened_image(path, ("PNG",), f"a whole PNG, {kind}, {size[0]} x {size[1]} pixels") as image:
        if image.size != size:
            raise InputError(path, f"{image.width} x {image.height} pixels",
                             f"{size[0]} x {size[1]}, as its camera in capture.json")
        if image.mode != mode:
            raise InputError(path, f"a PNG of mode {image.mode}", f"{kind} (mode {mode})")
        return np.asarray(image)


def read_image(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) float32 sRGB in [0, 1]; errors as ``read_png``."""
    return read_png(path, "RGB", size).astype(np.float32) / np.float32(255)


def read_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w) bool, true on the performer.

    Raises:
        InputError: as ``read_png``; or the mask is empty, or has values other than 0 and 255.
    """
    mask = read_png(path, "L", size)
    other = np.setdiff1d(mask, [0, 255])
    if other.size:
        raise InputError(path, f"a mask with the value {other[0]}", "only 0 (background) and 255 (performer)")
    if not mask.any():
        raise InputError(path, "an empty mask", "some pixels of 255 (performer)")
    return mask > 0


def write_image(path: Path, image: np.ndarray) -> None:
    """Writes (h, w, 3) sRGB, float in [0, 1] (rounded and clipped) or uint8, as an 8-bit PNG."""
    if image.dtype != np.uint8:
        image = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Writes (h, w) bool as an 8-bit, one-channel PNG of 0 and 255."""
    with replacing(path) as temporary:
        Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).save(temporary, format="PNG")


def undistort_image(image: np.ndarray, camera: Camera, background: np.ndarray) -> np.ndarray:
    """(h, w, 3) as seen by ``camera.pinhole()``, bilinear; ``background`` outside of the camera's image."""
    at = source_positions(camera)
    channels = [map_coordinates(image[..., i], at, order=1, cval=float(background[i])) for i in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def undistort_mask(mask: np.ndarray, camera: Camera) -> np.ndarray:
    """(h, w) bool as seen by ``camera.pinhole()``, from the nearest pixels."""
    return map_coordinates(mask.astype(np.uint8), source_positions(camera), order=0) > 0


def source_positions(camera: Camera) -> np.ndarray:
    """(2, h, w) row and column, 0 at a pixel's centre, that a pixel of ``camera.pinhole()`` sees."""
    ideal = camera.pinhole()
    rows, columns = np.mgrid[0 : ideal.h, 0 : ideal.w] + 0.5
    normalised = np.stack([(columns - ideal.cx) / ideal.fl_x, (rows - ideal.cy) / ideal.fl_y], axis=-1)
    distorted = camera.distort(normalised.reshape(-1, 2))
    seen = distorted * [camera.fl_x, camera.fl_y] + [camera.cx, camera.cy] - 0.5
    return seen.T[::-1].reshape(2, ideal.h, ideal.w)
