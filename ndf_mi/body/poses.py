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
        object.__setattr__(self, "frames", frames)
        shapes = {"vertices": (count, None, 3), "pose": (count, None, 3), "root_rotation": (count, 3),
                  "translation": (count, 3), "shape": (None,)}
        for name, shape in shapes.items():
            if (array := getattr(self, name)) is not None or name != "shape":
                object.__setattr__(self, name, arrays.floats(f"poses: {name}", array, shape))
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

    def check(self, body: Body) -> None:
        """Raises InputError unless vertices, joints and shape coefficients match those of ``body``."""
        used, vertices, joints = int(body.faces.max()) + 1, self.vertices.shape[1], self.pose.shape[1]
        shapes = 0 if self.shape is None else len(self.shape)
        if body.template is not None and vertices != len(body.template):
            raise InputError("poses: vertices", f"{vertices} vertices",
                             f"{len(body.template)}, as the body's template has")
        if vertices < used:
            raise InputError("poses: vertices", f"{vertices} vertices",
                             f"at least {used}, which the body's faces use")
        if body.joints is not None and joints != body.joint_count:
            raise InputError("poses: pose", f"{joints} joints", f"{body.joint_count}, as the body has")
        if self.shape is not None and body.shape_dirs is not None and shapes != body.shape_count:
            raise InputError("poses: shape", f"{shapes} coefficients",
                             f"{body.shape_count}, as the body has")

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
