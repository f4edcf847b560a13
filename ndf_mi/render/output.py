"""Writes images: multi-channel EXR in linear light, 8-bit PNG in sRGB."""

from __future__ import annotations

import os
from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.render.image import Image as FieldImage

SUFFIXES = (".exr", ".png")


def check_suffix(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless the file's name ends in .exr or .png."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(path, f"the ending {Path(path).suffix!r}", " or ".join(SUFFIXES))


def write_exr(path: str | os.PathLike[str], channels: dict[str, np.ndarray]) -> None:
    """Writes named channels, each (h, w), as 32-bit floats, lossless; completely or not at all."""
    pixels = np.stack(list(channels.values()), axis=-1).astype(np.float32)
    with files.replacing(path) as beside:
        mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, list(channels)).write(str(beside))


def write_png(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Writes (h, w, 3) sRGB in [0, 1] with 8 bits a channel, rounded; completely or not at all."""
    with files.replacing(path) as beside:
        Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(beside, format="PNG")


def write_field_image(path: str | os.PathLike[str], image: FieldImage, background: np.ndarray) -> None:
    """Writes an image of a field.

    With (u, v, l) and normals it becomes an EXR of all channels; without, a PNG over an sRGB background (3,).
    """
    if image.u is None or image.normal is None:
        write_png(path, image.over(background))
        return
    channels = {name: image.linear[..., i] for i, name in enumerate("RGB")}
    channels |= {"A": image.opacity, "depth.T": image.depth}
    channels |= {f"uvl.{n}": image.u[..., i] for i, n in enumerate("UVL")}
    channels |= {f"normal.{n}": image.normal[..., i] for i, n in enumerate("XYZ")}
    write_exr(path, channels)
