"""``capture.json``: cameras, splits and file patterns, parsed with every fault found, not the first alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.faults import Faults
from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json, shown

FORMAT = "ndf-capture"
VERSION = 1
FILE_NAME = "capture.json"
SPLITS = ("train", "novel_view", "novel_pose", "sequence")
IMAGE_PATTERN = "images/{camera}/{frame:06d}.png"
MASK_PATTERN = "masks/{camera}/{frame:06d}.png"

_DISTORTION = ("k1", "k2", "k3", "p1", "p2")
#: A name that can be a folder's on any system and cannot climb out of the capture.
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*")


@dataclass(frozen=True)
class Split:
    """The images of one purpose: every camera at every frame."""

    cameras: tuple[str, ...] = ()
    frames: tuple[int, ...] = ()

    def __iter__(self) -> Iterator[tuple[str, int]]:
        """All (camera, frame) pairs, camera by camera."""
        return ((camera, frame) for camera in self.cameras for frame in self.frames)

    def __len__(self) -> int:
        return len(self.cameras) * len(self.frames)

    def every(self, step: int) -> tuple[int, ...]:
        """The frames whose number is the least one's plus a multiple of ``step``."""
        first = min(self.frames, default=0)
        return tuple(frame for frame in self.frames if (frame - first) % step == 0)


@dataclass(frozen=True)
class Imported:
    """What a capture was imported from, and how much of it; the optional key ``imported``.

    Attributes:
        layout: ``zju`` or ``dynacap``, or whatever else a reader is called.
        subject: the subject or sequence, such as ``377``.
        cameras: the names of all cameras of the layout, in its order, whether or not they are in the capture.
        frames, test_frames: every how many-th frame was taken of all splits, and of the held-out ones.
        scale: size of the images made to that of those which the calibration belongs to.
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
    """``capture.json`` as values; cameras as written, distortion included. Patterns take ``camera`` and ``frame``."""

    name: str
    background: tuple[float, float, float]
    cameras: dict[str, Camera]
    splits: dict[str, Split]
    image_pattern: str = IMAGE_PATTERN
    mask_pattern: str = MASK_PATTERN
    lighting: str | None = None
    imported: Imported | None = None

    def images(self) -> list[tuple[str, int]]:
        """All (camera, frame) pairs that some split names, once each, sorted."""
        return sorted({pair for split in self.splits.values() for pair in split})

    def as_json(self) -> dict[str, Any]:
        """The document as JSON values; splits without an image are left out."""
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
        InputError: the first thing wrong with it.
    """
    document, faults = parse_document(folder)
    if document is None:
        raise faults[0]
    return document


def parse_document(folder: Path) -> tuple[Document | None, list[InputError]]:
    """Reads ``folder/capture.json``: the document, or None and everything that is wrong with it."""
    faults = Faults(folder / FILE_NAME)
    raw = _load(faults, folder)
    if raw is None or not _is_ours(raw, faults):
        return None, faults.found
    name = faults.text(raw.get("name"), "name")
    if raw.get("units") != "m":
        faults.add("units", shown(raw.get("units")), '"m"')
    background = _background(raw.get("background"), faults)
    patterns = [_pattern(raw.get(key), key, faults) for key in ("image_pattern", "mask_pattern")]
    cameras = _cameras(raw.get("cameras"), faults)
    splits = _splits(raw.get("splits"), cameras, faults)
    lighting = _lighting(raw.get("lighting"), folder, faults)
    imported = _imported(raw.get("imported"), faults)
    if faults.found or name is None or background is None or patterns[0] is None or patterns[1] is None:
        return None, faults.found
    return Document(name, background, cameras, splits, patterns[0], patterns[1], lighting, imported), []


def _load(faults: Faults, folder: Path) -> dict[str, Any] | None:
    try:
        raw = load_json(faults.file)
    except FileNotFoundError:
        what = "no such file" if folder.is_dir() else "no such folder"
        faults.add("", what, "a capture's description", "make one with: ndf-mi capture synthesise OUT")
        return None
    except ValueError as error:
        faults.add("", f"something that cannot be read as JSON ({error})", "a JSON object, UTF-8")
        return None
    if not isinstance(raw, dict):
        faults.add("", shown(raw), "a JSON object")
        return None
    return raw


def _is_ours(raw: dict[str, Any], faults: Faults) -> bool:
    version = raw.get("version")
    if raw.get("format") != FORMAT:
        faults.add("format", shown(raw.get("format")), f'"{FORMAT}"')
    elif not isinstance(version, int) or isinstance(version, bool) or version < 1:
        faults.add("version", shown(version), f"{VERSION}")
    elif version > VERSION:
        faults.add("version", f"{version}", f"{VERSION} or older", "this capture needs a newer ndf-mi")
    return not faults.found


def _background(value: Any, faults: Faults) -> tuple[float, float, float] | None:
    if not isinstance(value, list) or len(value) != 3:
        faults.add("background", shown(value), "[r, g, b], sRGB in [0, 1]")
        return None
    channels = [faults.number(channel, f"background[{i}]", 0, 1) for i, channel in enumerate(value)]
    red, green, blue = channels
    return None if red is None or green is None or blue is None else (red, green, blue)


def _pattern(value: Any, key: str, faults: Faults) -> str | None:
    text = faults.text(value, key)
    if text is None:
        return None
    try:
        names = {text.format(camera=camera, frame=frame) for camera in "ab" for frame in (1, 2)}
    except (KeyError, IndexError, ValueError, AttributeError, TypeError):
        names = set()
    if len(names) != 4 or any(Path(name).is_absolute() or ".." in Path(name).parts for name in names):
        faults.add(key, shown(text), f'a relative path of {{camera}} and {{frame}}, such as "{IMAGE_PATTERN}"')
        return None
    return text


def _cameras(value: Any, faults: Faults) -> dict[str, Camera]:
    if not isinstance(value, list) or not value:
        faults.add("cameras", shown(value), "a list of cameras")
        return {}
    cameras: dict[str, Camera] = {}
    for i, entry in enumerate(value):
        camera = _camera(entry, f"cameras[{i}]", faults)
        if camera is not None and camera.name in cameras:
            faults.add(f"cameras[{i}].name", shown(camera.name), "a name that no other camera has")
        elif camera is not None:
            cameras[camera.name] = camera
    return cameras


def _camera(entry: Any, key: str, faults: Faults) -> Camera | None:
    if not isinstance(entry, dict):
        faults.add(key, shown(entry), "an object")
        return None
    before = len(faults.found)
    name = faults.text(entry.get("name"), f"{key}.name")
    if name is not None and not _NAME.fullmatch(name):
        faults.add(f"{key}.name", shown(name), "letters, digits, '_', '-' and '.', since it names a folder")
    for side in ("w", "h"):
        if not isinstance(entry.get(side), int) or isinstance(entry.get(side), bool) or entry[side] < 1:
            faults.add(f"{key}.{side}", shown(entry.get(side)), "a positive whole number of pixels")
    focal = [faults.number(entry.get(k), f"{key}.{k}", 1e-6) for k in ("fl_x", "fl_y")]
    centre = [faults.number(entry.get(k), f"{key}.{k}") for k in ("cx", "cy")]
    distortion = [faults.number(entry.get(k, 0.0), f"{key}.{k}") for k in _DISTORTION]
    transform = _transform(entry.get("transform_matrix"), f"{key}.transform_matrix", faults)
    if len(faults.found) > before:
        return None
    intrinsics: Any = (*focal, *centre)
    fl_x, fl_y, cx, cy = intrinsics
    return Camera(str(name), entry["w"], entry["h"], fl_x, fl_y, cx, cy, transform, tuple(distortion))  # type: ignore[arg-type]


def _transform(value: Any, key: str, faults: Faults) -> np.ndarray:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        faults.add(key, shown(value), "4 x 4 finite numbers, camera to world")
    elif np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        faults.add(f"{key}[3]", shown(matrix[3].tolist()), "[0, 0, 0, 1]")
    elif np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() > 1e-3 or np.linalg.det(matrix[:3, :3]) < 0:
        faults.add(key, "a matrix that is not a rotation and a translation", "a rigid motion, right-handed")
    return matrix


def _splits(value: Any, cameras: dict[str, Camera], faults: Faults) -> dict[str, Split]:
    if not isinstance(value, dict):
        faults.add("splits", shown(value), f"an object of {', '.join(SPLITS)}")
        return {}
    for name in value:
        if name not in SPLITS:
            faults.add(f"splits.{name}", "a split of that name", f"{', '.join(SPLITS)} only")
    if not value.get("train"):
        faults.add("splits.train", shown(value.get("train")), "cameras and frames to learn from")
    splits = {name: _split(value[name], name, cameras, faults) for name in SPLITS if name in value}
    return {name: splits.get(name, Split()) for name in SPLITS}


def _split(value: Any, name: str, cameras: dict[str, Camera], faults: Faults) -> Split:
    key = f"splits.{name}"
    if not isinstance(value, dict):
        faults.add(key, shown(value), '{"cameras": [names], "frames": [whole numbers]}')
        return Split()
    names, frames = value.get("cameras"), value.get("frames")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        faults.add(f"{key}.cameras", shown(names), "a list of cameras' names")
        names = []
    for unknown in sorted(set(names) - set(cameras)):
        faults.add(f"{key}.cameras", shown(unknown), f"a camera listed under cameras ({', '.join(cameras) or 'none'})")
    whole = isinstance(frames, list) and all(isinstance(f, int) and not isinstance(f, bool) and f >= 0 for f in frames)
    if not whole or not frames:
        faults.add(f"{key}.frames", shown(frames), "a list of frame numbers, 0 or more")
        frames = []
    for what, values in (("cameras", names), ("frames", frames)):
        if len(set(values)) != len(values):
            faults.add(f"{key}.{what}", "an entry twice", "each once")
    return Split(tuple(names), tuple(frames))


def _lighting(value: Any, folder: Path, faults: Faults) -> str | None:
    if value is None:
        return None
    scene = value.get("scene") if isinstance(value, dict) else None
    if not isinstance(scene, str) or Path(scene).is_absolute() or ".." in Path(scene).parts:
        faults.add("lighting", shown(value), '{"scene": "FILE.xml"}, relative to the folder')
        return None
    if not (folder / scene).is_file():
        faults.add("lighting.scene", shown(scene), "a file in the capture's folder")
    return scene


def _imported(value: Any, faults: Faults) -> Imported | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        faults.add("imported", shown(value), "an object of layout, subject, cameras, frames, test_frames and scale")
        return None
    layout, subject = (faults.text(value.get(key), f"imported.{key}") for key in ("layout", "subject"))
    names = value.get("cameras")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        faults.add("imported.cameras", shown(names), "a list of cameras' names")
        names = []
    steps = [_step(value.get(key), f"imported.{key}", faults) for key in ("frames", "test_frames")]
    scale = faults.number(value.get("scale"), "imported.scale", 0, 1)
    if layout is None or subject is None or scale is None:
        return None
    return Imported(layout, subject, tuple(names), steps[0], steps[1], scale)


def _step(value: Any, key: str, faults: Faults) -> int:
    if type(value) is int and value > 0:
        return value
    faults.add(key, shown(value), "a whole number above 0")
    return 1


def _camera_as_json(camera: Camera) -> dict[str, Any]:
    value: dict[str, Any] = {"name": camera.name, "w": int(camera.w), "h": int(camera.h)}
    value.update({key: float(getattr(camera, key)) for key in ("fl_x", "fl_y", "cx", "cy")})
    value.update({key: float(k) for key, k in zip(_DISTORTION, camera.distortion, strict=True) if k})
    value["transform_matrix"] = np.asarray(camera.transform, dtype=np.float64).tolist()
    return value
