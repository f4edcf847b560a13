"""DynaCap (Habermann et al. 2021); docs/captures-from-elsewhere.md lists the assumptions.

The first 1,000 frames are for training, the next 1,000 are novel poses. Ten cameras are for training and five
for testing, spread evenly over the file's order. A folder with ``annots.npy`` is read as ZJU-MoCap's layout;
any other as::

    DIR/cameras.calibration                           or the only *.calibration: see `skeletool`
    DIR/images/C/image_c_C_f_F.jpg                    or .png; C: camera, F: frame
    DIR/foregroundSegmentation/C/image_c_C_f_F.png    or .jpg; above 127: performer
    DIR/params/F.npy, vertices/F.npy                  SMPL as in ZJU-MoCap's layout; or new_params, …
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ndf_mi.capture.document import Split
from ndf_mi.capture.readers.annotated import (
    FILE_NAME,
    fit_folder,
    numbered_files,
    read_annotations,
    source_with_fits,
)
from ndf_mi.capture.readers.skeletool import read_calibrations
from ndf_mi.capture.readers.source import Selection, Source
from ndf_mi.errors import InputError

LAYOUT = "dynacap"
FRAMES = 1000
"""Frames for training, followed by as many novel poses."""

TRAIN_CAMERAS, TEST_CAMERAS = 10, 5
"""Numbers of cameras; the publication does not name them."""

_CALIBRATION = "cameras.calibration"
_IMAGES, _MASKS = "images", "foregroundSegmentation"


def read_dynacap(folder: Path, selection: Selection | None = None, fits: str | None = None) -> Source:
    """Finds the files to import in the folder of a sequence; arguments and errors as for `zju.read_zju`."""
    folder, selection = Path(folder), selection or Selection()
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a sequence of DynaCap")
    name = folder.resolve().name
    if (folder / FILE_NAME).is_file():
        annotations = read_annotations(folder, None)
        rows = range(min(len(annotations.rows), 2 * FRAMES))
        numbers = annotations.numbers(rows, lambda file: int(Path(file).stem))
        cameras, above = annotations.calibrations, 0
        splits = _splits(folder, selection, list(cameras), numbers)
        images = annotations.images(splits, rows, numbers)
    else:
        cameras, above = read_calibrations(_calibration_file(folder)), 127
        numbers = sorted(numbered_files(fit_folder(folder, fits)))
        splits = _splits(folder, selection, list(cameras), numbers)
        images = {}
        for camera, frame in {pair for split in splits.values() for pair in split}:
            stem = f"{camera}/image_c_{camera}_f_{frame}"
            images[camera, frame] = (_file(folder / _IMAGES / stem, ".jpg", ".png"),
                                     _file(folder / _MASKS / stem, ".png", ".jpg"))
    return source_with_fits(folder, fits, LAYOUT, name, selection, cameras, splits, images, above)


def _splits(folder: Path, selection: Selection, names: list[str], numbers: Sequence[int]) -> dict[str, Split]:
    if len(numbers) <= FRAMES:
        raise InputError(folder, f"{len(numbers)} frames with a fit",
                         f"more than {FRAMES}: those for training, then novel poses")
    train, test = _spread(names)
    return selection.splits(names, train, test, numbers[:FRAMES], numbers[FRAMES : 2 * FRAMES])


def _spread(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Ten cameras for training and five for testing: every third of fifteen, spread evenly."""
    count = TRAIN_CAMERAS + TEST_CAMERAS
    if len(names) < count:
        return list(names), list(names)
    chosen = [names[i * len(names) // count] for i in range(count)]
    return [name for i, name in enumerate(chosen) if i % 3 != 1], chosen[1::3]


def _file(stem: Path, usual: str, other: str) -> Path:
    """The file with the other suffix if it exists, else the one with the usual suffix."""
    file = stem.with_name(stem.name + other)
    return file if file.is_file() else stem.with_name(stem.name + usual)


def _calibration_file(folder: Path) -> Path:
    file = folder / _CALIBRATION
    there = sorted(folder.glob("*.calibration"))
    if file not in there and len(there) > 1:
        raise InputError(file, f"{', '.join(f.name for f in there)} instead", "one calibration")
    return there[0] if len(there) == 1 else file
