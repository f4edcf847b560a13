"""Reads a capture: cameras, splits, images and masks, and the fitted body."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.document import FILE_NAME, Document, Imported, Split, read_document
from ndf_mi.capture.images import read_image, read_mask, undistort_image, undistort_mask
from ndf_mi.errors import InputError


class Capture:
    """A multi-view capture on disk. Images are read when asked for, and come undistorted.

    Attributes:
        path: the folder.
        name: the capture's name.
        background: (3,) float32 sRGB of the pixels outside the masks.
        cameras: by name, pinhole: images and masks are resampled to these where the real ones have distortion.
        splits: ``train``, ``novel_view``, ``novel_pose`` and ``sequence``; one that the file lacks is empty.
        imported: what it was imported from; None where the file does not say.
        body, poses: the fitted body.
        lighting: the Mitsuba scene of the light, a file, where it is known; else None.
        digest: SHA-256 of the description, the body and the poses, and of the names and sizes of the images and masks.
    """

    def __init__(self, path: Path, document: Document, body: Body, poses: Poses, digest: str) -> None:
        self.path = path
        self.name = document.name
        self.background = np.array(document.background, dtype=np.float32)
        self.cameras: dict[str, Camera] = {name: camera.pinhole() for name, camera in document.cameras.items()}
        self.splits: dict[str, Split] = document.splits
        self.imported: Imported | None = document.imported
        self.lighting: Path | None = None if document.lighting is None else path / document.lighting
        self.body = body
        self.poses = poses
        self.digest = digest
        self._document = document

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Capture:
        """Reads the capture in the folder ``path``; image files are looked for but not decoded.

        Raises:
            InputError: the first thing that is wrong; ``ndf_mi.capture.check.problems`` lists everything.
        """
        folder = Path(path)
        document = read_document(folder)
        body = Body.read(folder / "body.npz")
        poses = Poses.read(folder / "poses.npz", body)
        for fault in frame_faults(folder, document, poses):
            raise fault
        for file in image_files(folder, document):
            if not file.is_file():
                raise InputError(file, "no such file", f"a PNG, since a split of {FILE_NAME} names it")
        return cls(folder, document, body, poses, digest(folder, document))

    def image(self, camera: str, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1], composited over the background.

        Raises:
            InputError: no such camera or frame, or the file is missing, truncated or of another size or mode.
        """
        raw = self._camera(camera)
        file = self.path / self._document.image_pattern.format(camera=camera, frame=self._frame(camera, frame))
        image = read_image(file, (raw.w, raw.h))
        return image if raw.is_pinhole else undistort_image(image, raw, self.background)

    def mask(self, camera: str, frame: int) -> np.ndarray:
        """(h, w) bool, True on the performer.

        Raises:
            InputError: as ``image``; or the mask is empty or holds values other than 0 and 255.
        """
        raw = self._camera(camera)
        file = self.path / self._document.mask_pattern.format(camera=camera, frame=self._frame(camera, frame))
        mask = read_mask(file, (raw.w, raw.h))
        return mask if raw.is_pinhole else undistort_mask(mask, raw)

    def known_lighting(self) -> Path:
        """`lighting`, for what cannot do without.

        Raises:
            InputError: the capture says nothing of its light.
        """
        if self.lighting is None:
            raise InputError(f"{self.path / FILE_NAME}: lighting", "nothing",
                             'the Mitsuba scene of the light the performer was under, {"scene": "FILE.xml"}, FILE in the capture\'s folder')
        return self.lighting

    def _camera(self, name: str) -> Camera:
        camera = self._document.cameras.get(name)
        if camera is None:
            raise InputError(self.path / FILE_NAME, f"no camera {name}", f"one of {', '.join(self.cameras)}")
        return camera

    def _frame(self, camera: str, frame: int) -> int:
        splits = [split for split in self.splits.values() if camera in split.cameras]
        if not any(frame in split.frames for split in splits):
            known = sorted({f for split in splits for f in split.frames})
            raise InputError(
                self.path / FILE_NAME,
                f"no frame {frame} of camera {camera} in any split",
                f"one of {_ranges(known)}" if known else "a camera that a split names",
            )
        return frame


def image_files(folder: Path, document: Document) -> Iterator[Path]:
    """The image and the mask of every (camera, frame) that a split names, sorted."""
    for camera, frame in document.images():
        for pattern in (document.image_pattern, document.mask_pattern):
            yield folder / pattern.format(camera=camera, frame=frame)


def frame_faults(folder: Path, document: Document, poses: Poses) -> list[InputError]:
    """One error for each split that names frames which ``poses.npz`` lacks."""
    there = {int(frame) for frame in poses.frames}
    missing = {name: sorted(set(split.frames) - there) for name, split in document.splits.items()}
    return [
        InputError(
            f"{folder / FILE_NAME}: splits.{name}.frames",
            f"{_ranges(frames)}, which poses.npz lacks",
            f"frames of poses.npz: {_ranges(sorted(there))}",
        )
        for name, frames in missing.items()
        if frames
    ]


def digest(folder: Path, document: Document) -> str:
    """SHA-256 (hex) of the description, body and poses, and of the names and sizes of the images and masks."""
    state = hashlib.sha256()
    for name in (FILE_NAME, "body.npz", "poses.npz"):
        state.update((folder / name).read_bytes())
    for file in image_files(folder, document):
        state.update(f"{file.relative_to(folder).as_posix()} {file.stat().st_size}\n".encode())
    return state.hexdigest()


def _ranges(frames: list[int]) -> str:
    """Sorted frame numbers, runs of them joined: ``0-3, 7``."""
    runs: list[list[int]] = []
    for frame in frames:
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    return ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in runs)
