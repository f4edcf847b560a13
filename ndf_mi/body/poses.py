"""The fitted body in each frame (``poses.npz``)."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ndf_mi import files
from ndf_mi.body import arrays
from ndf_mi.body.body import Body
from ndf_mi.errors import InputError


@dataclass(frozen=True, eq=False)
class Poses:
    """T poses of one body.

    In world space, ``vertices = R(root_rotation)·X + translation``, where X is the body skinned with ``pose``
    and ``shape``, and R turns about the world's origin. Fields are checked and converted to their types.

    Attributes:
        frames: (T,) int32, ascending, not negative.
        vertices: (T, V, 3) float32, metres.
        pose: (T, J, 3) float32, axis-angle of each joint relative to its parent, radians; zero for the root.
        root_rotation: (T, 3) float32, axis-angle of the whole body about the world's origin, radians.
        translation: (T, 3) float32, metres, added after the rotation.
        shape: (B,) float32 shape coefficients, or None.

    Raises:
        InputError: a field is wrong; the message names it.
    """

    frames: np.ndarray
    vertices: np.ndarray
    pose: np.ndarray
    root_rotation: np.ndarray
    translation: np.ndarray
    shape: np.ndarray | None = None

    def __post_init__(self) -> None:
        frames = arrays.indices("poses: frames", self.frames, (None,), 0, np.iinfo(np.int32).max)
        count = len(frames)
        if count == 0 or (np.diff(frames) <= 0).any():
            raise InputError("poses: frames", frame_ranges(frames), "at least one frame, in ascending order")
        set_ = object.__setattr__
        set_(self, "frames", frames)
        set_(self, "vertices", arrays.floats("poses: vertices", self.vertices, (count, None, 3)))
        set_(self, "pose", arrays.floats("poses: pose", self.pose, (count, None, 3)))
        set_(self, "root_rotation", arrays.floats("poses: root_rotation", self.root_rotation, (count, 3)))
        set_(self, "translation", arrays.floats("poses: translation", self.translation, (count, 3)))
        if self.shape is not None:
            set_(self, "shape", arrays.floats("poses: shape", self.shape, (None,)))
        roots = np.abs(self.pose[:, :1]).max(initial=0)
        if roots > 1e-6:
            raise InputError("poses: pose", f"a root entry of {roots} radians",
                             "zero, since root_rotation turns the root")

    def __len__(self) -> int:
        return len(self.frames)

    def index(self, frame: int) -> int:
        """The row of ``frame``.

        Raises:
            InputError: no such frame; the message lists the existing ones.
        """
        row = int(np.searchsorted(self.frames, frame))
        if row == len(self.frames) or self.frames[row] != frame:
            raise InputError("frame", str(frame), f"one of {frame_ranges(self.frames)}")
        return row

    def check(self, body: Body, where: str = "poses") -> None:
        """Raises InputError unless vertices, joints and shape coefficients match those of ``body``."""
        used = int(body.faces.max()) + 1
        have = self.vertices.shape[1]
        if body.template is not None and have != len(body.template):
            expected = f"{len(body.template)}, as the body's template has"
            raise InputError(f"{where}: vertices", f"{have} vertices", expected)
        if have < used:
            raise InputError(f"{where}: vertices", f"{have} vertices",
                             f"at least {used}, which the body's faces use")
        if body.joints is not None and self.pose.shape[1] != body.joint_count:
            raise InputError(f"{where}: pose", f"{self.pose.shape[1]} joints",
                             f"{body.joint_count}, as the body has")
        if self.shape is not None and body.shape_dirs is not None and len(self.shape) != body.shape_count:
            expected = f"{body.shape_count}, as the body has"
            raise InputError(f"{where}: shape", f"{len(self.shape)} coefficients", expected)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes ``poses.npz`` atomically."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        files.write_npz(path, **{name: value for name, value in fields.items() if value is not None})

    @classmethod
    def read(cls, path: str | os.PathLike[str], body: Body) -> Poses:
        """Reads ``poses.npz`` and checks it against ``body``.

        Raises:
            InputError: the file or a field is wrong; the message names the key.
        """
        names = [f.name for f in dataclasses.fields(cls)]
        found = arrays.read_npz(path, names[:-1], names[-1:])
        with arrays.located("poses", path):
            poses = cls(**found)
            poses.check(body)
        return poses


def frame_ranges(frames: np.ndarray | Sequence[int]) -> str:
    """Ascending frame numbers for messages, such as ``0-3, 7``; at most eight runs."""
    frames = np.asarray(frames, dtype=np.int64)
    if len(frames) == 0:
        return "no frames"
    runs = np.split(frames, np.flatnonzero(np.diff(frames) != 1) + 1)
    names = [str(r[0]) if len(r) == 1 else f"{r[0]}-{r[-1]}" for r in runs]
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more runs" if len(names) > 8 else "")
