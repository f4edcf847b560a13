"""What a layout's reader finds in a folder, before any image is opened: calibrations, splits, and where the files lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.document import Split
from ndf_mi.errors import InputError

#: OpenGL's camera axes (x right, y up, looking along -z) seen from OpenCV's (x right, y down, looking along +z).
_CV_FROM_GL = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera as OpenCV has it: x_camera = R·x_world + T, then the distortion, then K.

    Attributes:
        name: fit to be a folder's name.
        where: file and key, for messages.
        matrix: K, (3, 3), pixels; the centre of the top left pixel is (0, 0).
        distortion: k1, k2, p1, p2, k3, in OpenCV's order.
        rotation: R, (3, 3).
        translation: T, (3,), metres.
        size: w, h of the image that K belongs to; None for that of the files. Images of another size are resized to it.

    Raises:
        InputError: a number isn't finite, R is no rotation, or K has no focal length or a skew, which no camera here can have.
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
        if np.abs(r @ r.T - np.eye(3)).max() > 1e-3 or np.linalg.det(r) < 0:
            raise InputError(f"{self.where}: R", "a matrix that is no rotation", "a rotation from world to camera")
        if min(k[0, 0], k[1, 1]) <= 0 or abs(k[0, 1]) > 1e-6 * k[0, 0] or np.abs(k[[1, 2, 2], [0, 0, 1]]).max() > 1e-9:
            raise InputError(f"{self.where}: K", str(k.tolist()), "focal lengths above 0 and no skew")

    def camera(self, size: tuple[int, int], turn: np.ndarray) -> Camera:
        """The camera for images of ``size`` (w, h), in a world turned by ``turn``, (3, 3)."""
        k1, k2, p1, p2, k3 = self.distortion
        transform = np.eye(4)
        transform[:3, :3] = turn @ self.rotation.T @ _CV_FROM_GL
        transform[:3, 3] = -turn @ self.rotation.T @ self.translation
        fx, fy, cx, cy = self.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        return Camera(self.name, *size, fx, fy, cx + 0.5, cy + 0.5, transform, (k1, k2, k3, p1, p2))


@dataclass(frozen=True)
class Selection:
    """Which part of a capture is imported.

    Attributes:
        frames: every how many-th frame of all splits is taken.
        test_frames: every how many-th frame of the held-out splits; a multiple of ``frames``, so that novel views are of frames
            that are trained on.
        train_cameras, test_cameras: names instead of the layout's own choice; empty for that.

    Raises:
        InputError: a number below 1, or one that is no multiple.
    """

    frames: int = 1
    test_frames: int = 30
    train_cameras: tuple[str, ...] = ()
    test_cameras: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("frames", "test_frames"):
            if getattr(self, name) < 1:
                raise InputError(f"--{name.replace('_', '-')}", str(getattr(self, name)), "a whole number above 0")
        if self.test_frames % self.frames:
            raise InputError("--test-frames", str(self.test_frames), f"a multiple of --frames, {self.frames}")

    def splits(
        self, names: Sequence[str], train: Sequence[str], test: Sequence[str], view_frames: Sequence[int], pose_frames: Sequence[int]
    ) -> dict[str, Split]:
        """The splits.

        Args:
            names: all cameras.
            train, test: the layout's own choice of them.
            view_frames: frames to train on, of which novel views are shown.
            pose_frames: frames of novel poses.

        Raises:
            InputError: a camera named is not there, or is trained and tested on; or none is left.
        """
        for option in ("train_cameras", "test_cameras"):
            unknown = sorted(set(getattr(self, option)) - set(names))
            if unknown:
                raise InputError(f"--{option.replace('_', '-')}", unknown[0], f"cameras of {', '.join(names)}")
        both = sorted(set(self.train_cameras) & set(self.test_cameras))
        if both:
            raise InputError("--test-cameras", f"{both[0]}, a training camera", "cameras not trained on")
        train = self.train_cameras or tuple(name for name in train if name not in self.test_cameras)
        test = self.test_cameras or tuple(name for name in test if name not in train)
        for option, chosen in (("train_cameras", train), ("test_cameras", test)):
            if not chosen:
                raise InputError(f"--{option.replace('_', '-')}", "no camera left", f"some of {', '.join(names)}")
        return {
            "train": Split(tuple(train), tuple(view_frames[:: self.frames])),
            "novel_view": Split(tuple(test), tuple(view_frames[:: self.test_frames])),
            "novel_pose": Split(tuple(test), tuple(pose_frames[:: self.test_frames])),
        }


@dataclass(frozen=True, eq=False)
class Source:
    """A capture as it lies in a folder of another layout.

    Attributes:
        layout: ``zju`` or ``dynacap``.
        subject: the subject's or sequence's name.
        selection: which part of it is imported.
        calibrations: by camera, all that the layout has, in its order.
        splits: ``train``, ``novel_view`` and ``novel_pose``.
        images: image and mask of every camera and frame that a split names.
        fits: by frame, the file with ``poses``, ``shapes``, ``Rh`` and ``Th``.
        vertices: by frame, the file with the posed vertices; empty where the layout comes without.
        pose_blend_shapes: whether the fits were made with them.
        mask_above: the value above which a mask's pixel is the performer's.
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
        """Raises InputError, naming the first, unless every file is there."""
        files = [*self.fits.values(), *self.vertices.values(), *(file for pair in self.images.values() for file in pair)]
        missing = [file for file in files if not file.is_file()]
        if missing:
            more = f", and {len(missing) - 1} more are missing" if len(missing) > 1 else ""
            raise InputError(missing[0], f"no such file{more}", f"all {len(files)} files of the frames and cameras chosen")
