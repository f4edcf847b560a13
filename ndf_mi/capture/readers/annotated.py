"""Folders in ZJU-MoCap's layout: ``annots.npy`` names cameras and images, the fitted body lies beside, a file a frame.

::

    DIR/annots.npy                      a pickled dict: cams (lists K, D, R, T) and ims (a list of {"ims": [a path a camera]})
    DIR/Camera_B1/00000.jpg …           wherever ims says
    DIR/mask_cihp/Camera_B1/00000.png   the same paths below mask_cihp or mask
    DIR/params/I.npy, vertices/I.npy    a pickled dict of poses, shapes, Rh, Th; posed vertices. Fitted without pose blend shapes
    DIR/new_params/, new_vertices/      the same, fitted with them
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ndf_mi import unpickle
from ndf_mi.body import arrays
from ndf_mi.capture.document import Split
from ndf_mi.capture.readers.source import Calibration
from ndf_mi.errors import InputError

FILE_NAME = "annots.npy"
FITS = {"new_params": "new_vertices", "params": "vertices"}
"""Folders of fits, those preferred first, with the folder of their vertices."""

_MASKS = ("mask_cihp", "mask")
_MILLIMETRES = 1e-3
#: Studios are no smaller: a camera nearer to the origin than this many millimetres tells that T is in metres.
_NEAREST = 50.0


@dataclass(frozen=True, eq=False)
class Annotations:
    """What ``annots.npy`` says: cameras in its order, and the images, a row a moment and a column a camera."""

    file: Path
    calibrations: dict[str, Calibration]
    rows: list[list[PurePosixPath]]

    def numbers(self, rows: range, number: Callable[[str], int]) -> list[int]:
        """The frames' numbers, by which fits are found; ``number`` reads one from an image's name.

        Raises:
            InputError: there are not as many rows; a name has no number; a row's images have several.
        """
        if rows.stop > len(self.rows):
            raise InputError(f"{self.file}: ims", f"{len(self.rows)} frames", f"{rows.stop} at least")
        result = []
        for row in rows:
            found = set()
            for path in self.rows[row]:
                try:
                    found.add(number(path.name))
                except (ValueError, IndexError):
                    raise InputError(f"{self.file}: ims[{row}]", f"the name {path.name}", "a name with the frame's number") from None
            if len(found) != 1:
                raise InputError(f"{self.file}: ims[{row}]", f"images of the frames {sorted(found)[:4]}", "images of one frame")
            result.append(found.pop())
        twice = [frame for i, frame in enumerate(result) if frame in result[:i]] if len(set(result)) < len(result) else []
        if twice:
            raise InputError(f"{self.file}: ims", f"frame {twice[0]} twice", "each frame once")
        return result

    def images(self, splits: dict[str, Split], rows: Sequence[int], numbers: Sequence[int]) -> dict[tuple[str, int], tuple[Path, Path]]:
        """Image and mask of every camera and frame of the splits; ``numbers`` are the frames of ``rows``."""
        folder = self.file.parent
        masks = next((folder / name for name in _MASKS if (folder / name).is_dir()), folder / _MASKS[0])
        row_of = dict(zip(numbers, rows, strict=True))
        column_of = {name: column for column, name in enumerate(self.calibrations)}
        found = {}
        for camera, frame in {pair for split in splits.values() for pair in split}:
            path = self.rows[row_of[frame]][column_of[camera]]
            found[camera, frame] = (folder / path, masks / path.with_suffix(".png"))
        return found


def read_annotations(folder: Path, size: tuple[int, int] | None) -> Annotations:
    """Reads ``annots.npy``; ``size`` (w, h) is that of the images which the cameras' K belong to, None for that of the files.

    Raises:
        InputError: it is missing, damaged, or lacks something, which the message names.
    """
    file = folder / FILE_NAME
    if not folder.is_dir():
        raise InputError(folder, "no such folder", f"a folder with {FILE_NAME}")
    held = unpickle.load_npy(file)
    if not isinstance(held, dict) or not isinstance(held.get("cams"), dict) or not isinstance(held.get("ims"), list):
        raise InputError(file, "no cams or no ims", "a pickled dict with cams and ims")
    rows = [_row(file, i, entry) for i, entry in enumerate(held["ims"])]
    if not rows:
        raise InputError(f"{file}: ims", "no frame", "at least one")
    lists = {key: held["cams"].get(key) for key in ("K", "D", "R", "T")}
    counts = {key: _length(value) for key, value in lists.items()}
    if len(set(counts.values())) != 1 or counts["K"] == 0:
        raise InputError(f"{file}: cams", f"{counts} entries", "K, D, R and T of each camera")
    wrong = [i for i, row in enumerate(rows) if len(row) != counts["K"]]
    if wrong:
        raise InputError(f"{file}: ims[{wrong[0]}]", f"{len(rows[wrong[0]])} images", f"one for each of {counts['K']} cameras")
    names = _names(rows[0])
    cameras = {name: _calibration(file, i, name, lists, size) for i, name in enumerate(names)}
    farthest = max(float(np.linalg.norm(camera.translation)) for camera in cameras.values()) / _MILLIMETRES
    if farthest < _NEAREST:
        repair = "multiply T by 1000 where it is in metres"
        raise InputError(f"{file}: cams.T", f"translations of {farthest:.3g} at most", "millimetres", repair)
    return Annotations(file, cameras, rows)


def fit_files(folder: Path, choice: str | None, frames: Sequence[int]) -> tuple[dict[int, Path], dict[int, Path], bool]:
    """Files of fits and of vertices (none where their folder is absent) by frame, and whether they have pose blend shapes.

    Args:
        folder: the capture's.
        choice: ``new_params`` or ``params``; None for the first of these that is there.
        frames: the frames' numbers.

    Raises:
        InputError: there is no such folder.
    """
    place = fit_folder(folder, choice)
    vertices = folder / FITS[place.name]
    return _files(place, frames), _files(vertices, frames if vertices.is_dir() else ()), place.name == "new_params"


def numbered_files(folder: Path) -> dict[int, Path]:
    """The ``.npy`` files of a folder whose names are numbers, by number; with leading zeros only where there is none without."""
    found = sorted((file for file in folder.glob("*.npy") if file.stem.isdecimal()), key=lambda file: -len(file.stem))
    return {int(file.stem): file for file in found}


def _files(folder: Path, frames: Sequence[int]) -> dict[int, Path]:
    """The file of each frame; where there is none, what it would be called."""
    there = numbered_files(folder) if frames else {}
    return {i: there.get(i, folder / f"{i}.npy") for i in frames}


def fit_folder(folder: Path, choice: str | None) -> Path:
    """The folder of fits: that of the name ``choice``, or the first of `FITS` that is there; InputError where there is none."""
    for name in [choice] if choice else FITS:
        if (folder / name).is_dir():
            return folder / name
    expected = "the fitted body, a file a frame" + ("" if choice else ", in new_params or params")
    raise InputError(folder / (choice or "new_params"), "no such folder", expected)


def _length(value: Any) -> int:
    """How many entries a list or an array has; 0 for anything else."""
    return len(value) if isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim) else 0


def _row(file: Path, i: int, entry: Any) -> list[PurePosixPath]:
    names = entry.get("ims") if isinstance(entry, dict) else None
    names = names.ravel().tolist() if isinstance(names, np.ndarray) else names
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(f"{file}: ims[{i}]", "no list of images", '{"ims": [a path for each camera]}')
    paths = [PurePosixPath(name.replace("\\", "/")) for name in names]
    for path in paths:
        if path.is_absolute() or ".." in path.parts or not path.name:
            raise InputError(f"{file}: ims[{i}]", f"the path {str(path)!r}", "a path inside the folder")
    return paths


def _names(row: list[PurePosixPath]) -> list[str]:
    """The cameras' names: their folders', with what cannot stand in a name replaced; numbers where that gives no name to each."""
    names = [re.sub(r"[^A-Za-z0-9.\-]+", "_", path.parent.name).strip("_.-") for path in row]
    return names if all(names) and len(set(names)) == len(names) else [f"camera{i:02d}" for i in range(len(row))]


def _calibration(file: Path, i: int, name: str, lists: dict[str, Any], size: tuple[int, int] | None) -> Calibration:
    parts = {}
    for key, count in (("K", 9), ("D", None), ("R", 9), ("T", 3)):
        array = arrays.regular(f"{file}: cams.{key}[{i}]", lists[key][i])
        if array.dtype.kind not in "iuf" or (count is not None and array.size != count):
            raise InputError(f"{file}: cams.{key}[{i}]", f"type {array.dtype}, shape {array.shape}", f"{count or 'up to 5'} numbers")
        parts[key] = array.astype(np.float64).ravel()
    distortion = parts["D"]
    if distortion[5:].any():
        raise InputError(f"{file}: cams.D[{i}]", f"{distortion.size} coefficients", "OpenCV's k1, k2, p1, p2, k3")
    distortion = np.pad(distortion[:5], (0, max(0, 5 - distortion.size)))
    k1, k2, p1, p2, k3 = distortion.tolist()
    rotation, translation = parts["R"].reshape(3, 3), parts["T"] * _MILLIMETRES
    return Calibration(name, f"{file}: cams[{i}]", parts["K"].reshape(3, 3), (k1, k2, p1, p2, k3), rotation, translation, size)
