"""Camera calibrations as text, DynaCap's format ("Skeletool Camera Calibration File").

A title, then a block of lines for each camera, from which these are read; matrices are row by row::

    name       0
      size       1285 940
      intrinsic  fx 0 cx 0  0 fy cy 0  0 0 1 0  0 0 0 1
      extrinsic  16 numbers: x_camera = E·x_world, OpenCV's axes, millimetres
      radial     0
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ndf_mi.capture.readers.source import Calibration
from ndf_mi.errors import InputError
from ndf_mi.files import read_lines

_MILLIMETRES = 1e-3
_NUMBERS = {"size": 2, "intrinsic": 16, "extrinsic": 16}


def read_calibrations(path: Path) -> dict[str, Calibration]:
    """The cameras by name. Radial distortion is refused, since its convention is unknown.

    Raises:
        InputError: the file is missing or not such a text, or a block lacks something; the message names the
            camera.
    """
    lines = read_lines(path, "the cameras' calibrations")
    blocks: dict[str, dict[str, list[str]]] = {}
    block: dict[str, list[str]] = {}
    for line in lines:
        key, *values = line.split() or [""]
        if key == "name" and values:
            if values[0] in blocks or not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*", values[0]):
                raise InputError(path, f"a camera named {values[0]!r}",
                                 "names of letters and digits, each once")
            block = blocks[values[0]] = {}
        else:
            block[key] = values
    if not blocks:
        raise InputError(path, "no camera", "blocks that start with a line `name NAME`")
    return {name: _calibration(f"{path}: camera {name}", name, block) for name, block in blocks.items()}


def _calibration(where: str, name: str, block: dict[str, list[str]]) -> Calibration:
    numbers = {}
    for key, count in _NUMBERS.items():
        try:
            numbers[key] = np.array([float(value) for value in block.get(key, ())])
        except ValueError:
            numbers[key] = np.empty(0)
        if numbers[key].size != count:
            raise InputError(f"{where}: {key}", " ".join(block.get(key, ()))[:60] or "nothing",
                             f"{count} numbers")
    if any(value != "0" for value in block.get("radial", ())):
        raise InputError(f"{where}: radial", " ".join(block["radial"])[:60],
                         "0, for images without distortion")
    width, height = numbers["size"]
    if width < 1 or height < 1 or width % 1 or height % 1:
        raise InputError(f"{where}: size", " ".join(block["size"]), "whole numbers of pixels")
    world = numbers["extrinsic"].reshape(4, 4)
    matrix = numbers["intrinsic"].reshape(4, 4)[:3, :3]
    size = (int(width), int(height))
    return Calibration(name, where, matrix, (0.0,) * 5, world[:3, :3], world[:3, 3] * _MILLIMETRES, size)
