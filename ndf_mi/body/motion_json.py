"""Motion written by hand: JSON keyframes of single joints, interpolated spherically.

::

    {"fps": 30,
     "frames": [{"time": 0, "joints": {"left_elbow": [0, 0, 0]}},
                {"time": 1, "joints": {"left_elbow": [0, -90, 0]}, "root": [0, 45, 0], "translation": [0, 0,
                0.5]}]}

Rotations are axis-angle in degrees relative to the parent, about the world's axes for the body at rest: x to
its left, y up, z ahead. ``root`` turns the whole body about its root joint, and ``translation``, metres,
moves it from its rest position. Each joint has its own keyframes, those that name it: before the first and
after the last it keeps still, and a joint without any stays at rest. Between two keyframes a joint takes the
shorter way: turns of more than 180° need a keyframe in between. Joints have the body's names or, with the
``cmu_mb`` rig, also SMPL's.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ndf_mi.body.body import Body
from ndf_mi.body.motion import Motion, frame_times, shaped_joints
from ndf_mi.body.motion_smpl import COUNTERPARTS, smpl_names
from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json, number, shown

_KEYS = ("time", "joints", "root", "translation")
Track = tuple[list[float], list[np.ndarray]]
"""Times in seconds, and three numbers at each."""


def play_json(
    body: Body, path: str | os.PathLike[str], fps: float | None = None, *, shape: np.ndarray | None = None
) -> tuple[Motion, float]:
    """Plays the keyframes of a file on a body; also returns the frames a second: ``fps``, or the file's own,
    or 30.

    Raises:
        InputError: the file is not JSON, or has an unknown key, a joint that the body lacks, times that do
            not ascend, no keyframe, or something else than three finite numbers.
    """
    path = Path(path)
    document = _load(path)
    frames = document.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path}: frames", "no keyframe", "a list of at least one")
    own = number(document.get("fps", 30), f"{path}: fps")
    if own <= 0:
        raise InputError(f"{path}: fps", f"{own:g}", "frames a second, above 0")
    joints = shaped_joints(body, shape)
    rotations, root, translation = _tracks(path, frames, _indices(body))
    fps = own if fps is None else fps
    times = frame_times(float(frames[-1]["time"]), fps)
    pose = np.zeros((len(times), len(joints), 3))
    for j, track in rotations.items():
        pose[:, j] = _turns(track, times).as_rotvec()
    turns = _turns(root, times)
    path_of_root = _moves(translation, times)
    origin = joints[0] - turns.apply(joints[0]) + path_of_root
    rotation = turns.as_rotvec().astype(np.float32)
    return Motion(pose.astype(np.float32), rotation, origin.astype(np.float32)), fps


def _load(path: Path) -> dict[str, Any]:
    try:
        document = load_json(path)
    except (FileNotFoundError, ValueError) as error:
        raise InputError(path, f"a file that cannot be read as JSON ({error})", "keyframes in JSON") from None
    if not isinstance(document, dict):
        raise InputError(path, f"a {type(document).__name__}",
                         'an object such as {"fps": 30, "frames": [...]}')
    return document


def _indices(body: Body) -> dict[str, int]:
    """All joints but the root, by their own names and by SMPL's."""
    own = body.joint_names or ()
    names = {name: j
             for j, name in enumerate(smpl_names(body) or [COUNTERPARTS.get(name, name) for name in own])}
    names |= {name: j for j, name in enumerate(own)}
    return {name: j for name, j in names.items() if j > 0}


def _tracks(path: Path, frames: list[Any], indices: dict[str, int]) -> tuple[dict[int, Track], Track, Track]:
    rotations: dict[int, Track] = {}
    root: Track = ([], [])
    translation: Track = ([], [])
    before = -math.inf
    for i, frame in enumerate(frames):
        where = f"{path}: frames[{i}]"
        if not isinstance(frame, dict):
            raise InputError(where, f"a {type(frame).__name__}", "an object with the key time")
        for key in frame:
            if key not in _KEYS:
                raise InputError(f"{where}.{key}", "a key of that name", f"{', '.join(_KEYS)} only")
        time = number(frame.get("time"), f"{where}.time")
        if time < 0 or time <= before:
            raise InputError(f"{where}.time", f"{time:g}", "seconds, 0 or more, in ascending order")
        before = time
        joints = frame.get("joints", {})
        if not isinstance(joints, dict):
            raise InputError(f"{where}.joints", f"a {type(joints).__name__}", "an object of joints")
        for name, value in joints.items():
            if name not in indices:
                raise InputError(f"{where}.joints", f"the joint {name!r}",
                                 f"a joint of the body other than its root: {', '.join(indices)}")
            _add(rotations.setdefault(indices[name], ([], [])), time, value, f"{where}.joints.{name}")
        for key, track in (("root", root), ("translation", translation)):
            if key in frame:
                _add(track, time, frame[key], f"{where}.{key}")
    return rotations, root, translation


def _add(track: Track, time: float, value: Any, where: str) -> None:
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(where, shown(value), "three numbers")
    if track[0] and track[0][-1] == time:
        raise InputError(where, "the same joint under two names", "each joint once in a keyframe")
    track[0].append(time)
    track[1].append(np.array([number(v, where) for v in value]))


def _turns(track: Track, times: np.ndarray) -> Rotation:
    at, vectors = track
    if not at:
        return Rotation.identity(len(times))
    keys = Rotation.from_rotvec(np.array(vectors), degrees=True)
    if len(at) == 1:
        return keys[np.zeros(len(times), dtype=np.intp)]
    return Slerp(at, keys)(np.clip(times, at[0], at[-1]))


def _moves(track: Track, times: np.ndarray) -> np.ndarray:
    at, points = track
    if not at:
        return np.zeros((len(times), 3))
    columns = np.array(points).T
    return np.stack([np.interp(times, at, column) for column in columns], axis=1)
