"""Reads a capture: cameras, splits, images, masks and the fitted body."""

from __future__ import annotations

import copy
import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses, frame_ranges
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.document import FILE_NAME, Document, Imported, Split, read_document
from ndf_mi.capture.images import read_image, read_matte, undistort_image, undistort_matte
from ndf_mi.errors import InputError


class Capture:
    """A multi-view capture on disk. Images are read on demand, and undistorted.

    Attributes:
        background: (3,) float32 sRGB of the pixels outside the masks.
        cameras: pinhole cameras by name. Images and masks of cameras with distortion are resampled to them.
        splits: ``train``, ``novel_view``, ``novel_pose`` and ``sequence``; those that the file lacks are
            empty.
        body, poses: the fitted body.
        lighting: the Mitsuba scene file of the light, or None if the light is not known.
        digest: SHA-256 of the description, body and poses, and of the names and sizes of images and masks.
    """

    def __init__(self, path: Path, document: Document, body: Body, poses: Poses, digest: str) -> None:
        self.path = path
        self.name = document.name
        self.background = np.array(document.background, dtype=np.float32)
        self.cameras = {name: camera.pinhole() for name, camera in document.cameras.items()}
        self.splits: dict[str, Split] = document.splits
        self.imported: Imported | None = document.imported
        self.lighting: Path | None = None if document.lighting is None else path / document.lighting
        self.body = body
        self.poses = poses
        self.digest = digest
        self._document = document

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Capture:
        """Reads the capture in the folder ``path``. Image files must exist, but are not decoded.

        Raises:
            InputError: the first issue; ``ndf_mi.capture.check.problems`` lists all.
        """
        folder = Path(path)
        document = read_document(folder)
        body = Body.read(folder / "body.npz")
        poses = Poses.read(folder / "poses.npz", body)
        for issue in frame_issues(folder, document, poses):
            raise issue
        for file in image_files(folder, document):
            if not file.is_file():
                raise InputError(file, "no such file", f"a PNG, which a split of {FILE_NAME} names")
        return cls(folder, document, body, poses, digest(folder, document))

    def with_body(self, body: Body, poses: Poses) -> Capture:
        """The same capture with another body, which has a pose for every frame of the splits."""
        changed = copy.copy(self)
        changed.body, changed.poses = body, poses
        return changed

    def with_cameras(self, cameras: Iterable[Camera]) -> Capture:
        """The same capture with these cameras in place of those of the same names; images stay."""
        changed = copy.copy(self)
        changed.cameras = self.cameras | {camera.name: camera for camera in cameras}
        return changed

    def image(self, camera: str, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1], composited over the background.

        Raises:
            InputError: no such camera or frame; or the file is missing, truncated, or of another size or
                mode.
        """
        raw, file, _ = self._found(camera, frame)
        image = read_image(file, (raw.w, raw.h))
        return image if raw.is_pinhole else undistort_image(image, raw, self.background)

    def mask(self, camera: str, frame: int) -> np.ndarray:
        """(h, w) bool, True on the performer: where ``matte`` is at least 0.5. Errors as ``matte``."""
        return self.matte(camera, frame) >= 0.5

    def matte(self, camera: str, frame: int) -> np.ndarray:
        """(h, w) float32 in [0, 1]: the share of each pixel that the performer covers, as far as the capture
        has mattes; 0 and 1 only where it has masks.

        Raises:
            InputError: as ``image``; or the file is empty, or neither a mask nor a matte
                (``ndf_mi.capture.images.read_matte``).
        """
        raw, _, file = self._found(camera, frame)
        matte = read_matte(file, (raw.w, raw.h))
        return matte if raw.is_pinhole else undistort_matte(matte, raw)

    def files(self, camera: str, frame: int) -> tuple[Path, Path]:
        """The files of an image and of its mask. Raises InputError if there is no such camera or frame."""
        return self._found(camera, frame)[1:]

    def known_lighting(self) -> Path:
        """`lighting`, if it is known.

        Raises:
            InputError: the capture does not describe its light.
        """
        if self.lighting is None:
            raise InputError(f"{self.path / FILE_NAME}: lighting", "nothing",
                             'the Mitsuba scene of the light in the capture\'s folder, {"scene": "FILE.xml"}')
        return self.lighting

    def _found(self, camera: str, frame: int) -> tuple[Camera, Path, Path]:
        """The camera as calibrated, the image's and the mask's file; raises InputError if there is none."""
        if camera not in self.cameras:
            raise InputError(self.path / FILE_NAME, f"no camera {camera}",
                             f"one of {', '.join(self.cameras)}")
        splits = [split for split in self.splits.values() if camera in split.cameras]
        if not any(frame in split.frames for split in splits):
            known = sorted({f for split in splits for f in split.frames})
            raise InputError(self.path / FILE_NAME, f"no frame {frame} of camera {camera} in any split",
                             f"one of {frame_ranges(known)}" if known else "a camera of a split")
        return self._document.cameras[camera], *self._document.files(self.path, camera, frame)


def image_files(folder: Path, document: Document) -> Iterator[Path]:
    """The image and mask files of every (camera, frame) of the splits, sorted."""
    for camera, frame in document.images():
        yield from document.files(folder, camera, frame)


def frame_issues(folder: Path, document: Document, poses: Poses) -> list[InputError]:
    """One issue for each split with frames that ``poses.npz`` lacks."""
    there = {int(frame) for frame in poses.frames}
    missing = {name: sorted(set(split.frames) - there) for name, split in document.splits.items()}
    return [InputError(f"{folder / FILE_NAME}: splits.{name}.frames",
                       f"{frame_ranges(frames)}, which poses.npz lacks",
                       f"frames of poses.npz: {frame_ranges(poses.frames)}")
            for name, frames in missing.items() if frames]


def digest(folder: Path, document: Document) -> str:
    """SHA-256 (hex) of the description, body and poses, and of the names and sizes of images and masks."""
    state = hashlib.sha256()
    for name in (FILE_NAME, "body.npz", "poses.npz"):
        state.update((folder / name).read_bytes())
    for file in image_files(folder, document):
        state.update(f"{file.relative_to(folder).as_posix()} {file.stat().st_size}\n".encode())
    return state.hexdigest()
