"""ZJU-MoCap's layout: ``annots.npy`` lists cameras and images; the fitted body is in a file for each frame.

::

    DIR/annots.npy                      a pickled dict: cams (lists K, D, R, T), ims ([{"ims": [paths]}, …])
    DIR/Camera_B1/00000.jpg …           as in ims
    DIR/mask_cihp/Camera_B1/00000.png   the same paths in mask_cihp or mask
    DIR/params/I.npy, vertices/I.npy    fitted without pose blend shapes: a pickled dict; vertices
    DIR/new_params/, new_vertices/      the same, with pose blend shapes
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ndf_mi import unpickle
from ndf_mi.body import arrays
from ndf_mi.capture.document import Split
from ndf_mi.capture.readers.source import Calibration, Selection, Source
from ndf_mi.errors import InputError

FILE_NAME = "annots.npy"
FITS = {"new_params": "new_vertices", "params": "vertices"}
"""Folders of fits with the folders of their vertices, in order of preference."""

_MASKS = ("mask_cihp", "mask")
_MILLIMETRES = 1e-3
#: No studio is smaller: a camera nearer to the origin than this many millimetres shows that T is in metres.
_NEAREST = 50.0


@dataclass(frozen=True, eq=False)
class Annotations:
    """The contents of ``annots.npy``: cameras, and images by rows (moments) and columns (cameras)."""

    file: Path
    calibrations: dict[str, Calibration]
    rows: list[list[PurePosixPath]]

    def numbers(self, rows: range, number: Callable[[str], int]) -> list[int]:
        """The frame numbers of rows, which name the fits; ``number`` reads one from an image's name.

        Raises:
            InputError: too few rows; a name without a number; or not one number for each row.
        """
        if rows.stop > len(self.rows):
            raise InputError(f"{self.file}: ims", f"{len(self.rows)} frames", f"at least {rows.stop}")
        result = []
        for row in rows:
            found = set()
            for path in self.rows[row]:
                try:
                    found.add(number(path.name))
                except (ValueError, IndexError):
                    raise InputError(f"{self.file}: ims[{row}]", f"the name {path.name}",
                                     "a name with the frame's number") from None
            if len(found) != 1:
                raise InputError(f"{self.file}: ims[{row}]", f"images of the frames {sorted(found)[:4]}",
                                 "images of one frame")
            result.append(found.pop())
        frame, count = Counter(result).most_common(1)[0] if result else (0, 0)
        if count > 1:
            raise InputError(f"{self.file}: ims", f"frame {frame} twice", "each frame once")
        return result

    def images(
        self, splits: dict[str, Split], rows: Sequence[int], numbers: Sequence[int]
    ) -> dict[tuple[str, int], tuple[Path, Path]]:
        """Image and mask files of the splits; ``numbers`` are the frames of ``rows``."""
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
    """Reads ``annots.npy``; ``size`` (w, h) is the calibrations', None for that of the files.

    Raises:
        InputError: the file is missing, damaged or incomplete; the message names the key.
    """
    file = folder / FILE_NAME
    if not folder.is_dir():
        raise InputError(folder, "no such folder", f"a folder with {FILE_NAME}")
    held = unpickle.load_npy(file)
    parts = (held.get("cams"), held.get("ims")) if isinstance(held, dict) else (None, None)
    if not isinstance(parts[0], dict) or not isinstance(parts[1], list):
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
        raise InputError(f"{file}: ims[{wrong[0]}]", f"{len(rows[wrong[0]])} images",
                         f"one for each of {counts['K']} cameras")
    names = _names(rows[0])
    cameras = {name: _calibration(file, i, name, lists, size) for i, name in enumerate(names)}
    farthest = max(float(np.linalg.norm(camera.translation)) for camera in cameras.values()) / _MILLIMETRES
    if farthest < _NEAREST:
        repair = "If T is in metres, multiply it by 1000."
        raise InputError(f"{file}: cams.T", f"translations of {farthest:.3g} at most", "millimetres", repair)
    return Annotations(file, cameras, rows)


def source_with_fits(
    folder: Path, choice: str | None, layout: str, subject: str, selection: Selection,
    calibrations: dict[str, Calibration], splits: dict[str, Split],
    images: dict[tuple[str, int], tuple[Path, Path]], mask_above: int = 0
) -> Source:  # fmt: skip
    """The source with the fits of ``folder`` and, if there is a folder of them, the posed vertices.

    Args:
        folder: the folder of the capture.
        choice: ``new_params`` or ``params``; None for the first of these that exists.

    Raises:
        InputError: no such folder.
    """
    place = fit_folder(folder, choice)
    vertices = folder / FITS[place.name]
    frames = sorted({frame for _, frame in images})
    posed = _files(vertices, frames if vertices.is_dir() else ())
    return Source(layout, subject, selection, calibrations, splits, images, _files(place, frames), posed,
                  place.name == "new_params", mask_above)


def numbered_files(folder: Path) -> dict[int, Path]:
    """The ``.npy`` files of a folder named by numbers, preferring those without leading zeros."""
    found = sorted((file for file in folder.glob("*.npy") if file.stem.isdecimal()),
                   key=lambda file: -len(file.stem))
    return {int(file.stem): file for file in found}


def _files(folder: Path, frames: Sequence[int]) -> dict[int, Path]:
    """The file of each frame, also if it does not exist."""
    there = numbered_files(folder) if frames else {}
    return {i: there.get(i, folder / f"{i}.npy") for i in frames}


def fit_folder(folder: Path, choice: str | None) -> Path:
    """The folder of fits ``choice``, or the first of `FITS` that exists; else InputError."""
    for name in [choice] if choice else FITS:
        if (folder / name).is_dir():
            return folder / name
    expected = "the fitted body, a file for each frame" + ("" if choice else ", in new_params or params")
    raise InputError(folder / (choice or "new_params"), "no such folder", expected)


def _length(value: Any) -> int:
    """The length of a list or an array; 0 for anything else."""
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
    """The cameras' names: their folders', with invalid characters replaced, or numbers."""
    names = [re.sub(r"[^A-Za-z0-9.\-]+", "_", path.parent.name).strip("_.-") for path in row]
    unique = all(names) and len(set(names)) == len(names)
    return names if unique else [f"camera{i:02d}" for i in range(len(row))]


def _calibration(
    file: Path, i: int, name: str, lists: dict[str, Any], size: tuple[int, int] | None
) -> Calibration:
    parts = {}
    for key, count in (("K", 9), ("D", None), ("R", 9), ("T", 3)):
        array = arrays.regular(f"{file}: cams.{key}[{i}]", lists[key][i])
        if array.dtype.kind not in "iuf" or (count is not None and array.size != count):
            raise InputError(f"{file}: cams.{key}[{i}]", f"type {array.dtype}, shape {array.shape}",
                             f"{count or 'up to 5'} numbers")
        parts[key] = array.astype(np.float64).ravel()
    if parts["D"][5:].any():
        raise InputError(f"{file}: cams.D[{i}]", f"{parts['D'].size} coefficients",
                         "OpenCV's k1, k2, p1, p2, k3")
    k1, k2, p1, p2, k3 = [*parts["D"].tolist(), 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return Calibration(name, f"{file}: cams[{i}]", parts["K"].reshape(3, 3), (k1, k2, p1, p2, k3),
                       parts["R"].reshape(3, 3), parts["T"] * _MILLIMETRES, size)
