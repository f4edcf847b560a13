"""Motion in AMASS's layout: ``poses`` of SMPL, SMPL-H or SMPL-X, ``trans``, frame rate, ``betas``.

The file's vertical is z, as in AMASS, or y; it becomes y. SMPL turns the body about its root joint, R·(X -
J_0) + J_0 + trans, where R comes from the first three numbers of ``poses`` (Loper et al. 2015). Here the body
turns about the world's origin.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body import arrays
from ndf_mi.body.body import Body
from ndf_mi.body.bvh import Clip
from ndf_mi.body.motion import Motion, frame_times, require_finite, retarget, shaped_joints
from ndf_mi.body.motion_smpl import LAYOUTS, cmu_clip, parents, smpl_names
from ndf_mi.errors import InputError

Up = Literal["z", "y"]
RATES = ("mocap_framerate", "mocap_frame_rate")
_Y_FROM_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_LEGS = tuple(tuple(f"{side}_{joint}" for joint in ("hip", "knee", "ankle")) for side in ("left", "right"))


def play_amass(
    body: Body, path: str | os.PathLike[str], fps: float, *, shape: np.ndarray | None = None, up: Up = "z"
) -> Motion:
    """Plays the motion of an AMASS-like file on a body, at ``fps`` frames a second.

    A body with SMPL's joints gets the file's rotations joint by joint (zero for joints that the file lacks,
    such as hands) and the path of the file's root joint, scaled by the ratio of the leg lengths if the file
    has ``betas`` and the body ``joint_dirs``. For any other body, which must have the ``cmu_mb`` rig, the
    motion is retargeted with the table of joints in `ndf_mi.body.motion_smpl`.

    Raises:
        InputError: an array is missing, has another number of joints or frames, no frame, or numbers that are
            not finite (with frame and joint); the frame rate is missing; or the motion lacks joints of the
            body.
    """
    clip = read_amass(path, up)
    times = frame_times(clip.duration, fps)
    names = smpl_names(body)
    if names is None:
        return retarget(body, cmu_clip(clip), times, shape=shape, alike=("LeftFoot", "RightFoot"))
    clip = clip.at(times)
    joints = shaped_joints(body, shape)
    root, ratio = joints[0], 1.0
    betas = None if body.joint_dirs is None else _betas(Path(path))
    if betas is not None:
        known = np.zeros(body.shape_count)
        known[: len(betas)] = betas[: body.shape_count]
        theirs = shaped_joints(body, known)
        root, ratio = theirs[0], _legs(names, joints) / _legs(names, theirs)
    turns = clip.rotations[:, 0]
    at = ratio * (clip.positions[:, 0] + root @ _upright(up).T)
    pose = np.zeros((len(clip), len(names), 3))
    for j, name in enumerate(names):
        if j > 0 and name in clip.joint_names:
            pose[:, j] = Rotation.from_matrix(clip.rotations[:, clip.joint_names.index(name)]).as_rotvec()
    path_of_origin = at - turns @ joints[0]
    rotation = Rotation.from_matrix(turns).as_rotvec()
    return Motion(pose.astype(np.float32), rotation.astype(np.float32), path_of_origin.astype(np.float32))


def read_amass(path: str | os.PathLike[str], up: Up = "z") -> Clip:
    """The file as a clip of SMPL's joints, y up. The positions of the root are ``trans``, without its rest
    position; the offsets of other joints, which the file does not have, are zero.

    Raises:
        InputError: see `play_amass`.
    """
    path = Path(path)
    found = arrays.read_npz(path, ("poses", "trans"), RATES)
    poses, trans = found["poses"], found["trans"]
    rate = _rate(path, found)
    width = int(np.prod(poses.shape[1:]))
    if poses.dtype.kind not in "fiu" or poses.ndim < 2 or width % 3 or width // 3 not in LAYOUTS:
        kinds = ", ".join(str(3 * n) for n in LAYOUTS)
        raise InputError(f"{path}: poses", f"type {poses.dtype}, shape {poses.shape}",
                         f"numbers of shape (T, one of {kinds})")
    count, names = len(poses), LAYOUTS[width // 3]
    if count == 0:
        raise InputError(f"{path}: poses", "no frame", "at least one")
    if trans.dtype.kind not in "fiu" or trans.shape != (count, 3):
        raise InputError(f"{path}: trans", f"type {trans.dtype}, shape {trans.shape}",
                         f"numbers of shape ({count}, 3), as many as poses")
    poses = poses.reshape(count, -1, 3).astype(np.float64)
    require_finite(f"{path}: poses", poses, names)
    require_finite(f"{path}: trans", trans[:, None].astype(np.float64), names)
    upright = _upright(up)
    rotations = Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix().reshape(count, -1, 3, 3)
    rotations[:, 0] = upright @ rotations[:, 0]
    positions = np.zeros((count, len(names), 3))
    positions[:, 0] = trans @ upright.T
    offsets = np.zeros((len(names), 3))
    return Clip(path.stem, names, parents(names), offsets, 1 / rate, positions, rotations)


def _betas(path: Path) -> np.ndarray | None:
    """The shape coefficients of the file, (B,) or (1, B); None if it has none."""
    betas = arrays.read_npz(path, (), ("betas",)).get("betas")
    if betas is None:
        return None
    flat = betas[0] if betas.ndim == 2 and len(betas) == 1 else betas
    return arrays.floats(f"{path}: betas", flat, (None,)).astype(np.float64)


def _rate(path: Path, found: dict[str, np.ndarray]) -> float:
    for key in RATES:
        if key in found:
            value = found[key]
            if value.dtype.kind not in "fiu" or value.size != 1 or not 0 < float(value.reshape(())) < np.inf:
                raise InputError(f"{path}: {key}", f"{value!r}", "one number above 0, in frames a second")
            return float(value.reshape(()))
    raise InputError(f"{path}: {RATES[0]}", "no frame rate", f"frames a second, in {' or '.join(RATES)}")


def _upright(up: Up) -> np.ndarray:
    return _Y_FROM_Z if up == "z" else np.eye(3)


def _legs(names: tuple[str, ...], joints: np.ndarray) -> float:
    at = {name: joint for name, joint in zip(names, joints, strict=True)}
    return float(sum(np.linalg.norm(at[a] - at[b])
                     for leg in _LEGS for a, b in zip(leg, leg[1:], strict=False)))
