"""Motion written by hand: JSON keyframes of single joints, interpolated spherically.

::

    {"fps": 30,
     "frames": [{"time": 0, "joints": {"left_elbow": [0, 0, 0]}},
                {"time": 1, "joints": {"left_elbow": [0, -90, 0]}, "root": [0, 45, 0],
                 "translation": [0, 0, 0.5]}]}

Rotations are axis-angle in degrees relative to the parent, about the world's axes for the body at rest: x to
its left, y up, z ahead. ``root`` turns the whole body about its root joint, and ``translation``, metres,
moves it from its rest position. Each joint has its own keyframes, those that name it: before the first and
after the last it keeps still, and a joint without any stays at rest. Between two keyframes a joint takes the
shorter way: turns of more than 180° need a keyframe in between. Joints have the body's names or, with the
``cmu_mb`` rig, also SMPL's.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct
from scipy.spatial.transform import Rotation, Slerp

from ndf_mi.body.body import Body
from ndf_mi.body.motion import Motion, frame_times, shaped_joints
from ndf_mi.body.motion_smpl import COUNTERPARTS, smpl_names
from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json, validated

Finite = Annotated[float, Meta(ge=-1.7e308, le=1.7e308)]
Vector = tuple[Finite, Finite, Finite]
_VECTOR: Any = Vector
_ROOT, _TRANSLATION = 0, -1


class Keyframe(Struct, forbid_unknown_fields=True):
    """Joint rotations, root rotation and translation at a time; see the module."""

    time: Annotated[float, Meta(ge=0, le=1.7e308)]
    joints: dict[str, Any] = {}
    root: Vector | None = None
    translation: Vector | None = None


class Keyframes(Struct):
    """A file of keyframes."""

    frames: Annotated[list[Keyframe], Meta(min_length=1)]
    fps: Annotated[float, Meta(gt=0, le=1.7e308)] = 30.0


Track = tuple[list[float], list[Vector]]
"""Times in seconds, and three numbers at each."""


def play_json(
    body: Body, path: str | os.PathLike[str], fps: float | None = None, *, shape: np.ndarray | None = None
) -> tuple[Motion, float]:
    """Plays a file's keyframes on a body; also returns frames a second: ``fps``, the file's or 30.

    Raises:
        InputError: the file is not JSON, or has an unknown key, a joint that the body lacks, times that do
            not ascend, no keyframe, or something else than three finite numbers.
    """
    path = Path(path)
    document = validated(load_json(path, "keyframes in JSON"), Keyframes, str(path))
    joints = shaped_joints(body, shape)
    tracks = _tracks(path, document.frames, _indices(body))
    fps = document.fps if fps is None else fps
    times = frame_times(document.frames[-1].time, fps)
    root, translation = tracks.pop(_ROOT, None), tracks.pop(_TRANSLATION, None)
    pose = np.zeros((len(times), len(joints), 3))
    for j, track in tracks.items():
        pose[:, j] = _turns(track, times).as_rotvec()
    turns = _turns(root, times)
    origin = joints[0] - turns.apply(joints[0]) + _moves(translation, times)
    rotation = turns.as_rotvec().astype(np.float32)
    return Motion(pose.astype(np.float32), rotation, origin.astype(np.float32)), fps


def _indices(body: Body) -> dict[str, int]:
    """All joints but the root, by their own names and by SMPL's."""
    own = body.joint_names or ()
    smpl = smpl_names(body) or [COUNTERPARTS.get(name, name) for name in own]
    return {name: j for names in (smpl, own) for j, name in enumerate(names) if j > 0}


def _tracks(path: Path, frames: list[Keyframe], indices: dict[str, int]) -> dict[int, Track]:
    """The tracks that have keyframes: of joints by index, of the root and the translation."""
    tracks: dict[int, Track] = {}
    before = -1.0
    for i, frame in enumerate(frames):
        where = f"{path}: frames[{i}]"
        if frame.time <= before:
            raise InputError(f"{where}.time", f"{frame.time:g}", "seconds in ascending order")
        before = frame.time
        found: dict[int, Vector | None] = {_ROOT: frame.root, _TRANSLATION: frame.translation}
        for name, value in frame.joints.items():
            if name not in indices:
                raise InputError(f"{where}.joints", f"the joint {name!r}",
                                 f"a joint of the body other than its root: {', '.join(indices)}")
            if indices[name] in found:
                raise InputError(f"{where}.joints.{name}", "the same joint under two names",
                                 "each joint once in a keyframe")
            found[indices[name]] = validated(value, _VECTOR, f"{where}.joints.{name}")
        for key, vector in found.items():
            if vector is not None:
                times, vectors = tracks.setdefault(key, ([], []))
                times.append(frame.time)
                vectors.append(vector)
    return tracks


def _turns(track: Track | None, times: np.ndarray) -> Rotation:
    if track is None:
        return Rotation.identity(len(times))
    at, vectors = track
    keys = Rotation.from_rotvec(np.array(vectors), degrees=True)
    if len(at) == 1:
        return keys[np.zeros(len(times), dtype=np.intp)]
    return Slerp(at, keys)(np.clip(times, at[0], at[-1]))


def _moves(track: Track | None, times: np.ndarray) -> np.ndarray:
    if track is None:
        return np.zeros((len(times), 3))
    return np.stack([np.interp(times, track[0], column) for column in np.array(track[1]).T], axis=1)
