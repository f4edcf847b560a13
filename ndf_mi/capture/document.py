"""``capture.json``: cameras, splits and file patterns. Reading it finds all issues, not only the first."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from ndf_mi.capture.camera import Camera, is_rotation
from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json, shown, validated

FORMAT = "ndf-capture"
VERSION = 1
FILE_NAME = "capture.json"
SPLITS = ("train", "novel_view", "novel_pose", "sequence")
IMAGE_PATTERN = "images/{camera}/{frame:06d}.png"
MASK_PATTERN = "masks/{camera}/{frame:06d}.png"

_DISTORTION = ("k1", "k2", "k3", "p1", "p2")
#: Names that are folders on any system, inside the capture.
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*")


Text = Annotated[str, Meta(min_length=1)]
Finite = Annotated[float, Meta(ge=-1.7e308, le=1.7e308)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Step = Annotated[int, Meta(ge=1)]
Pixels = Annotated[int, Meta(ge=1, le=2**31)]
Focal = Annotated[float, Meta(ge=1e-6, le=1.7e308)]
Row = tuple[Finite, Finite, Finite, Finite]


class CameraEntry(Struct):
    """A camera in ``capture.json``; the fields are those of `Camera`."""

    name: Text
    w: Pixels
    h: Pixels
    fl_x: Focal
    fl_y: Focal
    cx: Finite
    cy: Finite
    transform_matrix: tuple[Row, Row, Row, Row]
    k1: Finite = 0.0
    k2: Finite = 0.0
    k3: Finite = 0.0
    p1: Finite = 0.0
    p2: Finite = 0.0


class SplitEntry(Struct):
    """A split in ``capture.json``."""

    cameras: Annotated[tuple[str, ...], Meta(min_length=1)]
    frames: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(min_length=1)]


class LightingEntry(Struct):
    """The light in ``capture.json``: a Mitsuba scene, relative to the folder."""

    scene: str


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
        layout, subject: such as ``zju`` and ``377``.
        cameras: all cameras of the original, in its order, also those that are not in the capture.
        frames, test_frames: the step between the frames that were imported, and between the held-out ones.
        scale: size of the imported images relative to those of the calibration.
    """

    layout: Text
    subject: Text
    cameras: tuple[str, ...]
    frames: Step
    test_frames: Step
    scale: Fraction


@dataclass(frozen=True)
class Document:
    """The contents of ``capture.json``; cameras may be distorted. Patterns take ``camera``, ``frame``."""

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

    def files(self, folder: Path, camera: str, frame: int) -> tuple[Path, Path]:
        """The image's and the mask's file in the capture's folder."""
        patterns = (self.image_pattern, self.mask_pattern)
        image, mask = (folder / pattern.format(camera=camera, frame=frame) for pattern in patterns)
        return image, mask

    def as_json(self) -> dict[str, Any]:
        """The document as JSON values, without empty splits."""
        splits = {name: {"cameras": list(split.cameras), "frames": [int(f) for f in split.frames]}
                  for name, split in self.splits.items() if len(split)}
        value: dict[str, Any] = {
            "format": FORMAT, "version": VERSION, "name": self.name, "units": "m",
            "background": [float(c) for c in self.background],
            "image_pattern": self.image_pattern, "mask_pattern": self.mask_pattern,
            "cameras": [_camera_as_json(camera) for camera in self.cameras.values()], "splits": splits,
        }  # fmt: skip
        if self.lighting is not None:
            value["lighting"] = {"scene": self.lighting}
        if self.imported is not None:
            value["imported"] = vars(self.imported) | {"cameras": list(self.imported.cameras)}
        return value


@dataclass
class Issues:
    """All issues of a file, where raising an error would stop at the first."""

    file: Path
    found: list[InputError] = field(default_factory=list)

    def add(self, key: str, found: str, expected: str, repair: str = "") -> None:
        """Adds an issue with the value of a key, or with the whole file if the key is empty."""
        self.found.append(InputError(f"{self.file}: {key}" if key else self.file, found, expected, repair))

    def read(self, value: Any, kind: Any, key: str) -> Any:
        """The value of a key as a type that msgspec knows; otherwise None, with an issue added."""
        try:
            return validated(value, kind, f"{self.file}: {key}")
        except InputError as error:
            self.found.append(error)
            return None


def read_document(folder: Path) -> Document:
    """Reads ``folder/capture.json``; raises InputError at the first issue."""
    document, issues = parse_document(folder)
    if document is None:
        raise issues[0]
    return document


def parse_document(folder: Path) -> tuple[Document | None, list[InputError]]:
    """Reads ``folder/capture.json``: the document and no issues, or None and all issues."""
    issues = Issues(folder / FILE_NAME)
    try:
        raw = load_json(issues.file, "a capture's description, a JSON object in UTF-8")
    except InputError as error:
        found = error.found if folder.is_dir() else "no such folder"
        repair = "" if issues.file.exists() else "Make a capture with: ndf-mi capture synthesise OUT"
        return None, [InputError(error.where, found, error.expected, repair)]
    if not isinstance(raw, dict):
        issues.add("", shown(raw), "a JSON object")
    if issues.found or not _is_known(raw, issues):
        return None, issues.found
    name = issues.read(raw.get("name"), Text, "name")
    if raw.get("units") != "m":
        issues.add("units", shown(raw.get("units")), '"m"')
    background = issues.read(raw.get("background"), tuple[Fraction, Fraction, Fraction], "background")
    image_pattern = _pattern(raw.get("image_pattern"), "image_pattern", issues)
    mask_pattern = _pattern(raw.get("mask_pattern"), "mask_pattern", issues)
    cameras = _cameras(raw.get("cameras"), issues)
    splits = _splits(raw.get("splits"), cameras, issues)
    lighting = _lighting(raw.get("lighting"), folder, issues)
    imported = issues.read(raw.get("imported"), Imported | None, "imported")
    if issues.found:
        return None, issues.found
    return Document(name, background, cameras, splits, image_pattern, mask_pattern, lighting, imported), []


def _is_known(raw: dict[str, Any], issues: Issues) -> bool:
    version = raw.get("version")
    if raw.get("format") != FORMAT:
        issues.add("format", shown(raw.get("format")), f'"{FORMAT}"')
    elif not isinstance(version, int) or isinstance(version, bool) or version < 1:
        issues.add("version", shown(version), f"{VERSION}")
    elif version > VERSION:
        issues.add("version", f"{version}", f"{VERSION} or older", "Update ndf-mi to read this capture.")
    return not issues.found


def _pattern(value: Any, key: str, issues: Issues) -> str:
    text = issues.read(value, Text, key) or ""
    try:
        names = {text.format(camera=camera, frame=frame) for camera in "ab" for frame in (1, 2)}
    except (KeyError, IndexError, ValueError, AttributeError, TypeError):
        names = set()
    if text and (len(names) != 4 or any(Path(n).is_absolute() or ".." in Path(n).parts for n in names)):
        issues.add(key, shown(text),
                   f'a relative path with {{camera}} and {{frame}}, such as "{IMAGE_PATTERN}"')
    return text


def _cameras(value: Any, issues: Issues) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    entries = issues.read(value, Annotated[list[Any], Meta(min_length=1)], "cameras") or []
    for i, raw in enumerate(entries):
        key = f"cameras[{i}]"
        entry = issues.read(raw, CameraEntry, key)
        if entry is None:
            continue
        if not _NAME.fullmatch(entry.name):
            issues.add(f"{key}.name", shown(entry.name),
                       "letters, digits, '_', '-' and '.', for a folder's name")
        elif entry.name in cameras:
            issues.add(f"{key}.name", shown(entry.name), "a different name for each camera")
        distortion = (entry.k1, entry.k2, entry.k3, entry.p1, entry.p2)
        transform = _transform(entry.transform_matrix, f"{key}.transform_matrix", issues)
        cameras[entry.name] = Camera(entry.name, entry.w, entry.h, entry.fl_x, entry.fl_y, entry.cx, entry.cy,
                                     transform, distortion)
    return cameras


def _transform(rows: tuple[Row, Row, Row, Row], key: str, issues: Issues) -> np.ndarray:
    matrix = np.array(rows, dtype=np.float64)
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        issues.add(f"{key}[3]", shown(matrix[3].tolist()), "[0, 0, 0, 1]")
    elif not is_rotation(matrix[:3, :3]):
        issues.add(key, "a matrix that is not a rotation and a translation", "a right-handed rigid motion")
    return matrix


def _splits(value: Any, cameras: dict[str, Camera], issues: Issues) -> dict[str, Split]:
    splits = {name: Split() for name in SPLITS}
    raw = issues.read(value, dict[str, Any], "splits") or {}
    for name in raw:
        if name not in SPLITS:
            issues.add(f"splits.{name}", "a split of that name", f"only {', '.join(SPLITS)}")
    if not raw.get("train"):
        issues.add("splits.train", shown(raw.get("train")), "cameras and frames to train on")
    for name in [name for name in SPLITS if raw.get(name) is not None]:
        key = f"splits.{name}"
        entry = issues.read(raw[name], SplitEntry, key)
        if entry is None:
            continue
        for unknown in sorted(set(entry.cameras) - set(cameras)):
            issues.add(f"{key}.cameras", shown(unknown),
                       f"a camera of the capture ({', '.join(cameras) or 'none'})")
        for what, values in (("cameras", entry.cameras), ("frames", entry.frames)):
            if len(set(values)) != len(values):
                issues.add(f"{key}.{what}", "an entry twice", "each entry once")
        splits[name] = Split(entry.cameras, entry.frames)
    return splits


def _lighting(value: Any, folder: Path, issues: Issues) -> str | None:
    entry = issues.read(value, LightingEntry | None, "lighting")
    if entry is None:
        return None
    if Path(entry.scene).is_absolute() or ".." in Path(entry.scene).parts:
        issues.add("lighting", shown(value), '{"scene": "FILE.xml"}, relative to the folder')
    elif not (folder / entry.scene).is_file():
        issues.add("lighting.scene", shown(entry.scene), "a file in the folder of the capture")
    return entry.scene


def _camera_as_json(camera: Camera) -> dict[str, Any]:
    value: dict[str, Any] = {"name": camera.name, "w": int(camera.w), "h": int(camera.h)}
    value.update({key: float(getattr(camera, key)) for key in ("fl_x", "fl_y", "cx", "cy")})
    value.update({key: float(k) for key, k in zip(_DISTORTION, camera.distortion, strict=True) if k})
    value["transform_matrix"] = np.asarray(camera.transform, dtype=np.float64).tolist()
    return value
