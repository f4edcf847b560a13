"""ZJU-MoCap (Peng et al. 2021, Neural Body): nine subjects, in the layout of `annotated`.

Which frames and cameras are trained on and which are held out is that of Neural Body and of the field's paper: training cameras
0, 6, 12 and 18, all others tested; every 30th frame of the held-out splits.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ndf_mi.capture.readers.annotated import fit_files, read_annotations
from ndf_mi.capture.readers.source import Selection, Source
from ndf_mi.errors import InputError

LAYOUT = "zju"
TRAIN_CAMERAS = (0, 6, 12, 18)
"""Their places in the file's order; all others are tested."""
SIZE = (1024, 1024)
"""The size that the calibrations belong to; images of another size are resized to it first."""
SCALE = 0.5
"""Size of the images that the publications train on to `SIZE`."""


@dataclass(frozen=True)
class Subject:
    """A subject's peculiarities.

    Attributes:
        train: rows of ``annots.npy`` that are trained on, and shown from novel views.
        novel_pose: rows of novel poses.
        part: which part of an image's name, split at underscores, is the frame's number; None where the whole stem is.
    """

    train: range
    novel_pose: range
    part: int | None = None

    def number(self, name: str) -> int:
        """The frame's number in an image's file name; ValueError or IndexError where there is none."""
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
"""By the number in the folder's name, ``CoreView_313`` and so on. 313 and 315 count frames from 1, the others from 0."""


def read_zju(
    folder: Path,
    subject: str | None = None,
    selection: Selection | None = None,
    fits: str | None = None,
    size: tuple[int, int] | None = SIZE,
) -> Source:
    """Finds what is to be imported of a subject's folder; images are not opened.

    Args:
        folder: ``…/CoreView_377``.
        subject: one of `SUBJECTS`; None reads it from the folder's name.
        selection: frames and cameras; None for the layout's own.
        fits: ``new_params`` or ``params``; None takes the first of these that is there.
        size: w, h of the images that the calibrations belong to; None for that of the files.

    Raises:
        InputError: no such subject; or annotations or files are missing or damaged.
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
    files, vertices, blended = fit_files(folder, fits, sorted({frame for _, frame in images}))
    return Source(LAYOUT, key, selection, annotations.calibrations, splits, images, files, vertices, blended)


def _guess(folder: Path) -> str:
    found = [number for number in re.findall(r"\d+", folder.resolve().name) if number in SUBJECTS]
    if len(found) != 1:
        repair = f"name the subject: --subject {'|'.join(SUBJECTS)}"
        raise InputError(folder, "a folder's name that tells no subject", "a name such as CoreView_377", repair)
    return found[0]
