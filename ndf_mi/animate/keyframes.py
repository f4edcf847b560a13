"""Keyframed cameras in JSON, in nerfstudio's two layouts.

* ``transforms.json``: a list ``frames`` of objects with ``transform_matrix`` (4 × 4, camera to world, x
  right, y up, looking along -z; metres, y up) and optionally ``time`` in seconds; ``w``, ``h``, ``fl_x``,
  ``fl_y``, ``cx``, ``cy`` in pixels, in each object or once at the top level. By default ``fl_y`` equals
  ``fl_x`` and the principal point is the image's centre. Distortion is ignored.
* The viewer's export: a list ``camera_path`` of objects with ``camera_to_world`` (16 numbers, row by row) and
  ``fov``, the vertical field of view in degrees; ``render_width`` and ``render_height`` at the top level.

Without ``time`` the keyframes are spread evenly over the animation. Positions and intrinsics are interpolated
linearly, rotations spherically at constant speed. The camera stands still before the first and after the last
keyframe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.json_input import number, shown


@dataclass(frozen=True)
class Keyframe:
    """A camera, and the time in seconds after the first frame at which it is reached, if the file gives
    it."""

    time: float | None
    camera: Camera


def read_keyframes(document: dict[str, Any], path: Path) -> list[Keyframe]:
    """The keyframes of a document, at least one, all of one image size.

    Raises:
        InputError: an entry is missing or wrong.
    """
    key = "camera_path" if "camera_path" in document else "frames"
    entries = document.get(key)
    if not isinstance(entries, list) or not entries:
        raise InputError(path, f"no list {key} of cameras", "frames as in transforms.json, or camera_path")
    read = _exported if key == "camera_path" else _transforms
    frames = []
    for i, entry in enumerate(entries):
        where = f"{path}: {key}[{i}]"
        if not isinstance(entry, dict):
            raise InputError(where, f"a {type(entry).__name__}", "an object")
        time = None if entry.get("time") is None else number(entry["time"], f"{where}.time", 0)
        frames.append(Keyframe(time, read({**document, **entry}, where)))
        if (time is None) != (frames[0].time is None):
            raise InputError(f"{where}.time", "a time here but not in the first keyframe, or the reverse",
                             "a time in every keyframe or in none")
        if time is not None and i and time <= (frames[i - 1].time or 0):
            raise InputError(f"{where}.time", f"{time:g}", "seconds that increase from keyframe to keyframe")
        first, camera = frames[0].camera, frames[i].camera
        if (camera.w, camera.h) != (first.w, first.h):
            raise InputError(where, f"{camera.w} x {camera.h} pixels",
                             f"{first.w} x {first.h} as in the first")
    return frames


def interpolated(keyframes: list[Keyframe], count: int, fps: float) -> list[Camera]:
    """A camera for each of ``count`` frames, ``fps`` a second."""
    cameras = [key.camera for key in keyframes]
    first = cameras[0]
    if len(cameras) == 1:
        return [first] * count
    now = np.arange(count) / fps
    at = np.array([key.time for key in keyframes if key.time is not None])
    if len(at) == 0:
        at, now = np.arange(len(cameras)) / (len(cameras) - 1), np.linspace(0.0, 1.0, count)
    now = np.clip(now, at[0], at[-1])
    turns = Slerp(at, Rotation.from_matrix([c.transform[:3, :3] for c in cameras]))(now).as_matrix()
    columns = np.array([[*c.position, c.fl_x, c.fl_y, c.cx, c.cy] for c in cameras])
    values = np.stack([np.interp(now, at, column) for column in columns.T], axis=1)
    out = []
    for i in range(count):
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = turns[i], values[i, :3]
        fl_x, fl_y, cx, cy = values[i, 3:].tolist()
        out.append(Camera(first.name, first.w, first.h, fl_x, fl_y, cx, cy, transform))
    return out


def _transforms(entry: dict[str, Any], where: str) -> Camera:
    w, h = (_whole(entry.get(key), f"{where}.{key}") for key in ("w", "h"))
    fl_x = number(entry.get("fl_x"), f"{where}.fl_x", 1e-6)
    defaults = {"fl_y": fl_x, "cx": w / 2, "cy": h / 2}
    fl_y, cx, cy = (number(entry.get(key, value), f"{where}.{key}") for key, value in defaults.items())
    transform = _rigid(entry.get("transform_matrix"), f"{where}.transform_matrix")
    return Camera("keyframes", w, h, fl_x, fl_y, cx, cy, transform)


def _exported(entry: dict[str, Any], where: str) -> Camera:
    w, h = (_whole(entry.get(key), f"{where}.{key}") for key in ("render_width", "render_height"))
    fov = number(entry.get("fov"), f"{where}.fov", 1e-3)
    if fov >= 180:
        raise InputError(f"{where}.fov", f"{fov:g}", "degrees below 180")
    focal = 0.5 * h / math.tan(math.radians(0.5 * fov))
    transform = _rigid(entry.get("camera_to_world"), f"{where}.camera_to_world")
    return Camera("keyframes", w, h, focal, focal, w / 2, h / 2, transform)


def _whole(value: Any, where: str) -> int:
    pixels = number(value, where, 1)
    if pixels != int(pixels):
        raise InputError(where, f"{pixels:g}", "a whole number of pixels")
    return int(pixels)


def _rigid(value: Any, where: str) -> np.ndarray:
    try:
        matrix = np.array(value, dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError, OverflowError):
        raise InputError(where, shown(value), "4 x 4 numbers, camera to world") from None
    turn = matrix[:3, :3]
    rotation = np.isfinite(matrix).all() and np.abs(turn @ turn.T - np.eye(3)).max() <= 1e-3
    if not rotation or np.linalg.det(turn) < 0:
        raise InputError(where, "a matrix that is no rotation and translation", "a right-handed rigid motion")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise InputError(f"{where}[3]", shown(matrix[3].tolist()), "[0, 0, 0, 1]",
                         "Numbers are row by row, with the translation in the last column.")
    return matrix
