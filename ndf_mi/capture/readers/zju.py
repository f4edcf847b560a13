"""ZJU-MoCap (Peng et al. 2021, Neural Body): nine subjects, in the layout of `annotated`.

Frames and cameras are split as in Neural Body and NDF: cameras 0, 6, 12 and 18 for training, all others for
testing; every 30th frame of the held-out splits.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ndf_mi.capture.readers.annotated import read_annotations, source_with_fits
from ndf_mi.capture.readers.source import Selection, Source
from ndf_mi.errors import InputError

LAYOUT = "zju"
TRAIN_CAMERAS = (0, 6, 12, 18)
"""Indices in the file's order; all others are for testing."""
SIZE = (1024, 1024)
"""The image size of the calibrations; images of another size are resized to it first."""
SCALE = 0.5
"""Size of the images that the publications train on, relative to `SIZE`."""


@dataclass(frozen=True)
class Subject:
    """The frames of a subject.

    Attributes:
        train: rows of ``annots.npy`` for training and for novel views.
        novel_pose: rows for novel poses.
        part: index of the part of an image's name, split at underscores, that is the frame's number; None for
            the whole stem.
    """

    train: range
    novel_pose: range
    part: int | None = None

    def number(self, name: str) -> int:
        """The frame's number in an image's file name; raises ValueError or IndexError if it has none."""
        return int(Path(name).stem if self.part is None else name.split("_")[self.part])


SUBJECTS = {
    "313": Subject(range(60), range(60, 1060), part=4),
    "315": Subject(range(400), range(400, 1400), part=4),
    "377": Subject(range(300), range(300, 500)),
    "386": Subject(range(300), range(300, 646)),
    "387": Subject(range(300), range(300, 654)),
    "390": Subject(range(700, 1000), range(700)),
    "392": Subject(range(300), range(300, 556)),
    "393": Subject(range(300), range(300, 558)),
    "394": Subject(range(300), range(300, 859)),
}
"""Subjects by number, as in ``CoreView_313``. 313 and 315 count frames from 1, others from 0."""


def read_zju(
    folder: Path,
    subject: str | None = None,
    selection: Selection | None = None,
    fits: str | None = None,
    size: tuple[int, int] | None = SIZE,
) -> Source:
    """Finds the files to import in the folder of a subject; does not open images.

    Args:
        folder: ``…/CoreView_377``.
        subject: one of `SUBJECTS`; by default read from the folder's name.
        selection: frames and cameras; by default the protocol's.
        fits: ``new_params`` or ``params``; by default the first of these that exists.
        size: w, h of the images that the calibrations belong to; None for the size of the files.

    Raises:
        InputError: no such subject; annotations or files are missing or damaged.
    """
    folder, selection = Path(folder), selection or Selection()
    key = subject if subject is not None else _guess(folder)
    if key not in SUBJECTS:
        raise InputError("--subject", repr(key), f"one of {', '.join(SUBJECTS)}")
    of = SUBJECTS[key]
    annotations = read_annotations(folder, size)
    names = list(annotations.calibrations)
    view, pose = (annotations.numbers(rows, of.number) for rows in (of.train, of.novel_pose))
    train = [names[i] for i in TRAIN_CAMERAS if i < len(names)]
    splits = selection.splits(names, train, names, view, pose)
    images = annotations.images(splits, [*of.train, *of.novel_pose], [*view, *pose])
    return source_with_fits(folder, fits, LAYOUT, key, selection, annotations.calibrations, splits, images)


def _guess(folder: Path) -> str:
    found = [number for number in re.findall(r"\d+", folder.resolve().name) if number in SUBJECTS]
    if len(found) != 1:
        repair = f"Name the subject with --subject {'|'.join(SUBJECTS)}."
        raise InputError(folder, "a folder name without a subject", "a name such as CoreView_377", repair)
    return found[0]
