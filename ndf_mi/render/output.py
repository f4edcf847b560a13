"""Images to disk: multi-channel EXR in linear light, 8-bit PNG in sRGB."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import OpenEXR
from skimage.io import imsave

from ndf_mi import files
from ndf_mi.errors import InputError

SUFFIXES = (".exr", ".png")


def check_suffix(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless the file's name ends in .exr or .png."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(path, f"the ending {Path(path).suffix!r}", " or ".join(SUFFIXES))


def write_exr(path: str | os.PathLike[str], channels: dict[str, np.ndarray]) -> None:
    """Writes named channels, each (h, w), as 32-bit floats, compressed without loss; whole or not at all."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    arrays = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in channels.items()}
    with files.replacing(path) as beside:
        OpenEXR.File(header, arrays).write(str(beside))


def write_png(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Writes (h, w, 3) sRGB in [0, 1] as 8 bits a channel, rounded; whole or not at all."""
    with files.replacing(path) as beside:
        imsave(beside, np.round(np.clip(image, 0, 1) * 255).astype(np.uint8), check_contrast=False)
