"""SMPL fitted to ZJU-MoCap: ``params/I.npy`` and ``vertices/I.npy``.

V = R(Rh)·X(θ, β) + Th with θ[:3] = 0 and R about the world's origin, which is the convention of
`ndf_mi.body.poses.Poses`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi import unpickle
from ndf_mi.body import arrays
from ndf_mi.errors import InputError

JOINTS = 24


@dataclass(frozen=True, eq=False)
class Fits:
    """T fits. Metres, radians, float64.

    Attributes:
        pose: (T, 24, 3), the root's entry zero.
        root_rotation, translation: (T, 3).
        shape: (B,), the mean over the fits, which all belong to one performer.
    """

    pose: np.ndarray
    root_rotation: np.ndarray
    translation: np.ndarray
    shape: np.ndarray

    def turned(self, turn: np.ndarray) -> Fits:
        """The same fits in a world rotated by ``turn``, (3, 3)."""
        root = Rotation.from_matrix(turn) * Rotation.from_rotvec(self.root_rotation)
        return replace(self, root_rotation=root.as_rotvec(), translation=self.translation @ turn.T)

    def upright(self) -> np.ndarray:
        """(3, 3) rotation by quarter turns that makes y point up, along the performer's mean up."""
        up = Rotation.from_rotvec(self.root_rotation).as_matrix()[:, :, 1].mean(0)
        axis = int(np.abs(up).argmax())
        if axis == 1:
            return np.diag([1.0, np.sign(up[1]), np.sign(up[1])])
        turn = np.pi / 2 * np.cross(np.sign(up[axis]) * np.eye(3)[axis], [0.0, 1.0, 0.0])
        return Rotation.from_rotvec(turn).as_matrix().round() + 0.0  # without negative zeros


def read_fits(files: Sequence[Path]) -> Fits:
    """Reads fits, one from each file.

    Raises:
        InputError: a file is missing, damaged or lacks a key; a number is not finite; or a pose does not have
            SMPL's length (72, or 69 without the root), or turns its root.
    """
    parts = [_read(file) for file in files]
    shapes = {len(part[3]) for part in parts}
    if len(shapes) != 1:
        raise InputError(f"{files[0]}: shapes", f"{sorted(shapes)} coefficients from fit to fit",
                         "the same number in each fit")
    pose, root, translation, shape = (np.stack(column) for column in zip(*parts, strict=True))
    return Fits(pose, root, translation, shape.mean(0))


def read_vertices(files: Sequence[Path]) -> np.ndarray:
    """(T, V, 3) float32 posed vertices, one file for each frame.

    Raises:
        InputError: a file is missing, damaged, or of another shape than the first.
    """
    found: list[np.ndarray] = []
    for file in files:
        count = len(found[0]) if found else None
        array = arrays.regular(f"{file}", unpickle.load_npy(file))
        found.append(arrays.floats(f"{file}", array[0] if array.ndim == 3 and len(array) == 1 else array,
                                   (count, 3)))
    return np.stack(found)


def _read(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    held = unpickle.load_npy(file)
    if not isinstance(held, dict):
        raise InputError(file, f"a {type(held).__name__}", "a pickled dict of poses, shapes, Rh and Th")
    found = {}
    for key in ("poses", "shapes", "Rh", "Th"):
        if key not in held:
            raise InputError(f"{file}: {key}", f"only {', '.join(map(str, held)) or 'nothing'}",
                             f"an array {key!r}")
        # Checked as float32, but kept in double precision until the world is rotated.
        numbers = arrays.regular(f"{file}: {key}", held[key]).ravel()
        arrays.floats(f"{file}: {key}", numbers, (None,))
        found[key] = numbers.astype(np.float64)
    pose = found["poses"]
    if pose.size == 3 * (JOINTS - 1):
        pose = np.concatenate([np.zeros(3), pose])
    if pose.size != 3 * JOINTS:
        raise InputError(f"{file}: poses", f"{pose.size} numbers", "SMPL's 72, or 69 without the root")
    if np.abs(pose[:3]).max() > 1e-6:
        expected = "zeros, since Rh turns the whole body about the world's origin"
        raise InputError(f"{file}: poses", f"{pose[:3].round(4).tolist()} for the root", expected)
    pose[:3] = 0
    for key in ("Rh", "Th"):
        arrays.check_shape(f"{file}: {key}", found[key], (3,))
    return pose.reshape(JOINTS, 3), found["Rh"], found["Th"], found["shapes"]
