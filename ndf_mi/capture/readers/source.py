"""What the reader of a layout finds in a folder before it opens images: calibrations, splits and files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ndf_mi.capture.camera import Camera, is_rotation
from ndf_mi.capture.document import Split
from ndf_mi.errors import InputError

#: From OpenGL's camera axes (x right, y up, looking along -z) to OpenCV's (x right, y down, along +z).
_CV_FROM_GL = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera in OpenCV's convention: x_camera = R·x_world + T, then distortion, then K.

    Attributes:
        name: valid as a folder's name.
        where: file and key, for error messages.
        matrix: K, (3, 3), pixels; the centre of the top left pixel is (0, 0).
        distortion: k1, k2, p1, p2, k3, in OpenCV's order.
        rotation: R, (3, 3).
        translation: T, (3,), metres.
        size: w, h of the images that K belongs to, to which others are resized; None for the size of the
            files.

    Raises:
        InputError: a number is not finite, R is not a rotation, or K has no focal length or a skew.
    """

    name: str
    where: str
    matrix: np.ndarray
    distortion: tuple[float, float, float, float, float]
    rotation: np.ndarray
    translation: np.ndarray
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        parts = {"K": self.matrix, "R": self.rotation, "T": self.translation, "D": np.array(self.distortion)}
        for key, part in parts.items():
            if not np.isfinite(part).all():
                raise InputError(f"{self.where}: {key}", "numbers that are not finite", "finite numbers")
        k, r = self.matrix, self.rotation
        if not is_rotation(r):
            raise InputError(f"{self.where}: R", "a matrix that is not a rotation",
                             "a rotation from world to camera")
        skewed = abs(k[0, 1]) > 1e-6 * k[0, 0] or np.abs(k[[1, 2, 2], [0, 0, 1]]).max() > 1e-9
        if min(k[0, 0], k[1, 1]) <= 0 or skewed:
            raise InputError(f"{self.where}: K", str(k.tolist()), "focal lengths above 0 and no skew")

    def camera(self, size: tuple[int, int], turn: np.ndarray) -> Camera:
        """The camera for images of ``size`` (w, h), in a world rotated by ``turn``, (3, 3)."""
        k1, k2, p1, p2, k3 = self.distortion
        transform = np.eye(4)
        transform[:3, :3] = turn @ self.rotation.T @ _CV_FROM_GL
        transform[:3, 3] = -turn @ self.rotation.T @ self.translation
        fx, fy, cx, cy = self.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        return Camera(self.name, *size, fx, fy, cx + 0.5, cy + 0.5, transform, (k1, k2, k3, p1, p2))


@dataclass(frozen=True)
class Selection:
    """The part of a capture to import; InputError if a number is below 1 or not such a multiple.

    Attributes:
        frames: step between the frames of all splits.
        test_frames: step between the frames of the held-out splits; a multiple of ``frames``, so that novel
            views show frames that are trained on.
        train_cameras, test_cameras: names of cameras, by default those of the layout's protocol.
    """

    frames: int = 1
    test_frames: int = 30
    train_cameras: tuple[str, ...] = ()
    test_cameras: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for option, step in (("--frames", self.frames), ("--test-frames", self.test_frames)):
            if step < 1:
                raise InputError(option, str(step), "a whole number above 0")
        if self.test_frames % self.frames:
            raise InputError("--test-frames", str(self.test_frames), f"a multiple of --frames, {self.frames}")

    def splits(
        self, names: Sequence[str], train: Sequence[str], test: Sequence[str], view_frames: Sequence[int],
        pose_frames: Sequence[int]
    ) -> dict[str, Split]:
        """The splits, of all cameras ``names`` and the protocol's ``train`` and ``test``; ``view_frames`` are
        trained on and also shown in novel views.

        Raises:
            InputError: a chosen camera does not exist, or is used for training and testing; or no camera
                remains.
        """
        for option, chosen in (
            ("--train-cameras", self.train_cameras),
            ("--test-cameras", self.test_cameras),
        ):
            unknown = sorted(set(chosen) - set(names))
            if unknown:
                raise InputError(option, unknown[0], f"cameras among {', '.join(names)}")
        both = sorted(set(self.train_cameras) & set(self.test_cameras))
        if both:
            raise InputError("--test-cameras", f"{both[0]}, a training camera",
                             "cameras that are not trained on")
        train = self.train_cameras or tuple(name for name in train if name not in self.test_cameras)
        test = self.test_cameras or tuple(name for name in test if name not in train)
        for option, chosen in (("--train-cameras", train), ("--test-cameras", test)):
            if not chosen:
                raise InputError(option, "no camera", f"some of {', '.join(names)}")
        return {"train": Split(tuple(train), tuple(view_frames[:: self.frames])),
                "novel_view": Split(tuple(test), tuple(view_frames[:: self.test_frames])),
                "novel_pose": Split(tuple(test), tuple(pose_frames[:: self.test_frames]))}


@dataclass(frozen=True, eq=False)
class Source:
    """A capture in another layout.

    Attributes:
        layout: ``zju`` or ``dynacap``.
        subject: the subject's or sequence's name.
        calibrations: of all cameras by name, in the layout's order.
        splits: ``train``, ``novel_view`` and ``novel_pose``.
        images: image and mask files of every camera and frame of the splits.
        fits: the file with ``poses``, ``shapes``, ``Rh`` and ``Th`` of each frame.
        vertices: the file with the posed vertices of each frame; empty if the layout has none.
        pose_blend_shapes: whether the fits were made with pose blend shapes.
        mask_above: pixels of a mask above this value are the performer's.
    """

    layout: str
    subject: str
    selection: Selection
    calibrations: dict[str, Calibration]
    splits: dict[str, Split]
    images: dict[tuple[str, int], tuple[Path, Path]]
    fits: dict[int, Path]
    vertices: dict[int, Path]
    pose_blend_shapes: bool
    mask_above: int = 0

    @property
    def name(self) -> str:
        """The capture's name."""
        return f"{self.layout}-{self.subject}"

    def check_files(self) -> None:
        """Raises InputError, naming the first missing file, unless all files exist."""
        files = [*self.fits.values(), *self.vertices.values(),
                 *(file for pair in self.images.values() for file in pair)]
        missing = [file for file in files if not file.is_file()]
        if missing:
            more = f", and {len(missing) - 1} more are missing" if len(missing) > 1 else ""
            raise InputError(missing[0], f"no such file{more}",
                             f"all {len(files)} files of the chosen frames and cameras")
