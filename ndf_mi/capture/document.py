"""``capture.json``: cameras, splits and file patterns. Reading it finds all issues, not only the first."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi.capture.camera import Camera, is_rotation
from ndf_mi.capture.issues import Issues
from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json, shown

FORMAT = "ndf-capture"
VERSION = 1
FILE_NAME = "capture.json"
SPLITS = ("train", "novel_view", "novel_pose", "sequence")
IMAGE_PATTERN = "images/{camera}/{frame:06d}.png"
MASK_PATTERN = "masks/{camera}/{frame:06d}.png"

_DISTORTION = ("k1", "k2", "k3", "p1", "p2")
#: Names that are folders on any system, inside the capture.
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*")


@dataclass(frozen=True)
class Split:
    """The images for one purpose: every camera at every frame."""

    cameras: tuple[str, ...] = ()
    frames: tuple[int, ...] = ()

    def __iter__(self) -> Iterator[tuple[str, int]]:
        """All (camera, frame) pairs, camera by camera."""
        return ((camera, frame) for camera in self.cameras for frame in self.frames)

    def __len__(self) -> int:
        return len(self.cameras) * len(self.frames)

    def every(self, step: int) -> tuple[int, ...]:
        """The frames whose number differs from the least by a multiple of ``step``."""
        first = min(self.frames, default=0)
        return tuple(frame for frame in self.frames if (frame - first) % step == 0)


@dataclass(frozen=True)
class Imported:
    """What a capture was imported from, and which part of it: the optional key ``imported``.

    Attributes:
        layout: the reader's name, such as ``zju`` or ``dynacap``.
        subject: the subject or sequence, such as ``377``.
        cameras: all cameras of the original, in its order, also those that are not in the capture.
        frames, test_frames: the step between the frames that were imported, and between the held-out ones.
        scale: size of the imported images relative to those of the calibration.
    """

    layout: str
    subject: str
    cameras: tuple[str, ...]
    frames: int
    test_frames: int
    scale: float

    def as_json(self) -> dict[str, Any]:
        """The entries as JSON values."""
        return asdict(self) | {"cameras": list(self.cameras)}


@dataclass(frozen=True)
class Document:
    """The contents of ``capture.json``. Cameras may have distortion; patterns take ``camera`` and
    ``frame``.
    """

    name: str
    background: tuple[float, float, float]
    cameras: dict[str, Camera]
    splits: dict[str, Split]
    image_pattern: str = IMAGE_PATTERN
    mask_pattern: str = MASK_PATTERN
    lighting: str | None = None
    imported: Imported | None = None

    def images(self) -> list[tuple[str, int]]:
        """All (camera, frame) pairs of the splits, without repetition, sorted."""
        return sorted({pair for split in self.splits.values() for pair in split})

    def as_json(self) -> dict[str, Any]:
        """The document as JSON values, without empty splits."""
        value: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "units": "m",
            "background": [float(c) for c in self.background],
            "image_pattern": self.image_pattern,
            "mask_pattern": self.mask_pattern,
            "cameras": [_camera_as_json(camera) for camera in self.cameras.values()],
            "splits": {
                name: {"cameras": list(split.cameras), "frames": [int(f) for f in split.frames]}
                for name, split in self.splits.items()
                if len(split)
            },
        }
        if self.lighting is not None:
            value["lighting"] = {"scene": self.lighting}
        if self.imported is not None:
            value["imported"] = self.imported.as_json()
        return value


def read_document(folder: Path) -> Document:
    """Reads ``folder/capture.json``.

    Raises:
        InputError: the first issue.
    """
    document, issues = parse_document(folder)
    if document is None:
        raise issues[0]
    return document


def parse_document(folder: Path) -> tuple[Document | None, list[InputError]]:
    """Reads ``folder/capture.json``: the document and no issues, or None and all issues."""
    issues = Issues(folder / FILE_NAME)
    raw = _load(issues, folder)
    if raw is None or not _is_known(raw, issues):
        return None, issues.found
    name = issues.text(raw.get("name"), "name")
    if raw.get("units") != "m":
        issues.add("units", shown(raw.get("units")), '"m"')
    background = _background(raw.get("background"), issues)
    patterns = [_pattern(raw.get(key), key, issues) for key in ("image_pattern", "mask_pattern")]
    cameras = _cameras(raw.get("cameras"), issues)
    splits = _splits(raw.get("splits"), cameras, issues)
    lighting = _lighting(raw.get("lighting"), folder, issues)
    imported = _imported(raw.get("imported"), issues)
    if issues.found or name is None or background is None or patterns[0] is None or patterns[1] is None:
        return None, issues.found
    return Document(name, background, cameras, splits, patterns[0], patterns[1], lighting, imported), []


def _load(issues: Issues, folder: Path) -> dict[str, Any] | None:
    try:
        raw = load_json(issues.file)
    except FileNotFoundError:
        found = "no such file" if folder.is_dir() else "no such folder"
        issues.add("", found, "a capture's description", "Make a capture with: ndf-mi capture synthesise OUT")
        return None
    except ValueError as error:
        issues.add("", f"a file that cannot be read as JSON ({error})", "a JSON object, UTF-8")
        return None
    if not isinstance(raw, dict):
        issues.add("", shown(raw), "a JSON object")
        return None
    return raw


def _is_known(raw: dict[str, Any], issues: Issues) -> bool:
    version = raw.get("version")
    if raw.get("format") != FORMAT:
        issues.add("format", shown(raw.get("format")), f'"{FORMAT}"')
    elif not isinstance(version, int) or isinstance(version, bool) or version < 1:
        issues.add("version", shown(version), f"{VERSION}")
    elif version > VERSION:
        issues.add("version", f"{version}", f"{VERSION} or older", "Update ndf-mi to read this capture.")
    return not issues.found


def _background(value: Any, issues: Issues) -> tuple[float, float, float] | None:
    if not isinstance(value, list) or len(value) != 3:
        issues.add("background", shown(value), "[r, g, b], sRGB in [0, 1]")
        return None
    channels = [issues.number(channel, f"background[{i}]", 0, 1) for i, channel in enumerate(value)]
    red, green, blue = channels
    return None if red is None or green is None or blue is None else (red, green, blue)


def _pattern(value: Any, key: str, issues: Issues) -> str | None:
    text = issues.text(value, key)
    if text is None:
        return None
    try:
        names = {text.format(camera=camera, frame=frame) for camera in "ab" for frame in (1, 2)}
    except (KeyError, IndexError, ValueError, AttributeError, TypeError):
        names = set()
    if len(names) != 4 or any(Path(name).is_absolute() or ".." in Path(name).parts for name in names):
        issues.add(key, shown(text),
                   f'a relative path with {{camera}} and {{frame}}, such as "{IMAGE_PATTERN}"')
        return None
    return text


def _cameras(value: Any, issues: Issues) -> dict[str, Camera]:
    if not isinstance(value, list) or not value:
        issues.add("cameras", shown(value), "a list of cameras")
        return {}
    cameras: dict[str, Camera] = {}
    for i, entry in enumerate(value):
        camera = _camera(entry, f"cameras[{i}]", issues)
        if camera is not None and camera.name in cameras:
            issues.add(f"cameras[{i}].name", shown(camera.name), "a different name for each camera")
        elif camera is not None:
            cameras[camera.name] = camera
    return cameras


def _camera(entry: Any, key: str, issues: Issues) -> Camera | None:
    if not isinstance(entry, dict):
        issues.add(key, shown(entry), "an object")
        return None
    before = len(issues.found)
    name = issues.text(entry.get("name"), f"{key}.name")
    if name is not None and not _NAME.fullmatch(name):
        issues.add(f"{key}.name", shown(name), "letters, digits, '_', '-' and '.', for a folder's name")
    expected = "a positive whole number of pixels"
    w, h = (issues.whole(entry.get(side), f"{key}.{side}", expected) for side in "wh")
    focal = [issues.number(entry.get(k), f"{key}.{k}", 1e-6) for k in ("fl_x", "fl_y")]
    centre = [issues.number(entry.get(k), f"{key}.{k}") for k in ("cx", "cy")]
    distortion = [issues.number(entry.get(k, 0.0), f"{key}.{k}") for k in _DISTORTION]
    transform = _transform(entry.get("transform_matrix"), f"{key}.transform_matrix", issues)
    if len(issues.found) > before:
        return None
    intrinsics: Any = (*focal, *centre)
    fl_x, fl_y, cx, cy = intrinsics
    return Camera(str(name), w, h, fl_x, fl_y, cx, cy, transform, tuple(distortion))  # type: ignore[arg-type]


def _transform(value: Any, key: str, issues: Issues) -> np.ndarray:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        issues.add(key, shown(value), "4 x 4 finite numbers, from camera to world")
    elif np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        issues.add(f"{key}[3]", shown(matrix[3].tolist()), "[0, 0, 0, 1]")
    elif not is_rotation(matrix[:3, :3]):
        issues.add(key, "a matrix that is not a rotation and a translation", "a right-handed rigid motion")
    return matrix


def _splits(value: Any, cameras: dict[str, Camera], issues: Issues) -> dict[str, Split]:
    if not isinstance(value, dict):
        issues.add("splits", shown(value), f"an object of {', '.join(SPLITS)}")
        return {}
    for name in value:
        if name not in SPLITS:
            issues.add(f"splits.{name}", "a split of that name", f"only {', '.join(SPLITS)}")
    if not value.get("train"):
        issues.add("splits.train", shown(value.get("train")), "cameras and frames to train on")
    splits = {name: _split(value[name], name, cameras, issues) for name in SPLITS if name in value}
    return {name: splits.get(name, Split()) for name in SPLITS}


def _split(value: Any, name: str, cameras: dict[str, Camera], issues: Issues) -> Split:
    key = f"splits.{name}"
    if not isinstance(value, dict):
        issues.add(key, shown(value), '{"cameras": [names], "frames": [whole numbers]}')
        return Split()
    names, frames = value.get("cameras"), value.get("frames")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        issues.add(f"{key}.cameras", shown(names), "a list of cameras' names")
        names = []
    for unknown in sorted(set(names) - set(cameras)):
        issues.add(f"{key}.cameras", shown(unknown),
                   f"a camera of the capture ({', '.join(cameras) or 'none'})")
    if not isinstance(frames, list) or not frames or not all(type(f) is int and f >= 0 for f in frames):
        issues.add(f"{key}.frames", shown(frames), "a list of frame numbers, 0 or more")
        frames = []
    for what, values in (("cameras", names), ("frames", frames)):
        if len(set(values)) != len(values):
            issues.add(f"{key}.{what}", "an entry twice", "each entry once")
    return Split(tuple(names), tuple(frames))


def _lighting(value: Any, folder: Path, issues: Issues) -> str | None:
    if value is None:
        return None
    scene = value.get("scene") if isinstance(value, dict) else None
    if not isinstance(scene, str) or Path(scene).is_absolute() or ".." in Path(scene).parts:
        issues.add("lighting", shown(value), '{"scene": "FILE.xml"}, relative to the folder')
        return None
    if not (folder / scene).is_file():
        issues.add("lighting.scene", shown(scene), "a file in the folder of the capture")
    return scene


def _imported(value: Any, issues: Issues) -> Imported | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        issues.add("imported", shown(value),
                   "an object of layout, subject, cameras, frames, test_frames and scale")
        return None
    layout, subject = (issues.text(value.get(key), f"imported.{key}") for key in ("layout", "subject"))
    names = value.get("cameras")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        issues.add("imported.cameras", shown(names), "a list of cameras' names")
        names = []
    steps = [issues.whole(value.get(key), f"imported.{key}", "a whole number above 0")
             for key in ("frames", "test_frames")]
    scale = issues.number(value.get("scale"), "imported.scale", 0, 1)
    if layout is None or subject is None or scale is None:
        return None
    return Imported(layout, subject, tuple(names), steps[0], steps[1], scale)


def _camera_as_json(camera: Camera) -> dict[str, Any]:
    value: dict[str, Any] = {"name": camera.name, "w": int(camera.w), "h": int(camera.h)}
    value.update({key: float(getattr(camera, key)) for key in ("fl_x", "fl_y", "cx", "cy")})
    value.update({key: float(k) for key, k in zip(_DISTORTION, camera.distortion, strict=True) if k})
    value["transform_matrix"] = np.asarray(camera.transform, dtype=np.float64).tolist()
    return value
