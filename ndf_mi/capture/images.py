"""The PNG files of a capture: reads, checks, writes and undistorts 8-bit images, masks and mattes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import binary_erosion, map_coordinates

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.files import replacing

#: Least value, of 255, that the largest of a mask must have. Masks of 0 and 1 and of labels have far less.
_OPAQUE = 128
#: Least :func:`half_covered` of a matte.
_LEAST_HALF_COVERED = 0.1


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


def read_matte(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w) float32 in [0, 1]: the share of each pixel that the performer covers; 0 and 1 only for a mask.

    Raises:
        InputError: as ``read_png``; or no pixel shows the performer; or the file is damaged: its values end
            far below 255, as in a mask of 0 and 1 or of labels, or it has the noise of lossy compression.
    """
    matte = read_png(path, "L", size)
    largest = int(matte.max())
    if largest == 0:
        raise InputError(path, "an empty mask", "some pixels of 255 (performer)")
    if largest < _OPAQUE:
        values = np.unique(matte)
        if len(values) == 2 and values[0] == 0:
            found, repair = f"a mask of 0 and {largest}", f"Multiply it by {255 / largest:g}."
        else:
            found = f"a mask with {len(values)} different values, the largest {largest}"
            repair = "If the values are labels, write 255 where they are the performer's and 0 elsewhere."
        raise InputError(path, found, f"255 on the performer (a matte's largest value is {_OPAQUE} or more)",
                         repair)
    noisy = np.count_nonzero((matte > 0) & (matte < 255))
    if noisy and half_covered(matte) < _LEAST_HALF_COVERED:
        raise InputError(
            path, f"a mask with {noisy} pixels near 0 or 255 but hardly any between, as lossy compression "
            f"leaves them ({100 * half_covered(matte):.0f} pixels between 32 and 223 on 100 of the outline)",
            f"0 and 255 only, or a matte ({100 * _LEAST_HALF_COVERED:.0f} such pixels or more)",
            "Write 255 where the value is above 127 and 0 elsewhere, or use the file before compression.")
    return matte.astype(np.float32) / np.float32(255)


def read_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(h, w) bool, true where the matte is at least 0.5; errors as ``read_matte``."""
    return read_matte(path, size) >= 0.5


def is_soft(matte: np.ndarray) -> bool:
    """Whether any value of a matte in [0, 1] is neither 0 nor 1."""
    return bool(((matte > 0) & (matte < 1)).any())


def half_covered(matte: np.ndarray) -> float:
    """Pixels of a uint8 matte between 32 and 223, for each pixel on the outline of those above 127.

    From 0.7 on where an image is averaged over pixels, and more if it is blurred. 0 for masks of 0 and 255
    after lossy compression, except at low qualities (JPEG at 50 and less in images of 128 pixels: 0.4).
    """
    on = matte > 127
    outline = int(np.count_nonzero(on & ~binary_erosion(on)))
    return int(np.count_nonzero((matte >= 32) & (matte <= 223))) / max(outline, 1)


def write_image(path: Path, image: np.ndarray) -> None:
    """Writes (h, w, 3) sRGB, float in [0, 1] (rounded and clipped) or uint8, as an 8-bit PNG."""
    if image.dtype != np.uint8:
        image = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Writes a mask, (h, w) bool, as an 8-bit, one-channel PNG of 0 and 255, or a matte, float in [0, 1], of
    values between them too."""
    with replacing(path) as temporary:
        Image.fromarray(np.round(np.clip(mask, 0, 1) * np.float32(255)).astype(np.uint8)).save(
            temporary, format="PNG")


def undistort_image(image: np.ndarray, camera: Camera, background: np.ndarray) -> np.ndarray:
    """(h, w, 3) as seen by ``camera.pinhole()``, bilinear; ``background`` outside of the camera's image."""
    at = source_positions(camera)
    channels = [map_coordinates(image[..., i], at, order=1, cval=float(background[i])) for i in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def undistort_matte(matte: np.ndarray, camera: Camera) -> np.ndarray:
    """(h, w) float32 as seen by ``camera.pinhole()``: mattes bilinearly, masks of 0 and 1 from the nearest
    pixels, so that they stay masks."""
    return map_coordinates(matte, source_positions(camera), order=1 if is_soft(matte) else 0)


def source_positions(camera: Camera) -> np.ndarray:
    """(2, h, w) row and column, 0 at a pixel's centre, that a pixel of ``camera.pinhole()`` sees."""
    ideal = camera.pinhole()
    rows, columns = np.mgrid[0 : ideal.h, 0 : ideal.w] + 0.5
    normalised = np.stack([(columns - ideal.cx) / ideal.fl_x, (rows - ideal.cy) / ideal.fl_y], axis=-1)
    distorted = camera.distort(normalised.reshape(-1, 2))
    seen = distorted * [camera.fl_x, camera.fl_y] + [camera.cx, camera.cy] - 0.5
    return seen.T[::-1].reshape(2, ideal.h, ideal.w)
