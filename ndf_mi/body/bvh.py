"""BVH motion files: a hierarchy of joints with channels, then a line of numbers for each frame."""

from __future__ import annotations

import contextlib
import math
import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.errors import InputError
from ndf_mi.files import read_lines

_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")


@dataclass(frozen=True, eq=False)
class Clip:
    """A motion of J joints over T frames, in the file's unit, y up. Parents precede their children.

    Attributes:
        name: the clip's name in messages.
        joint_names: J names as in the file.
        parents: (J,) int32, -1 for the root, which comes first.
        offsets: (J, 3) float64, each joint relative to its parent at rest.
        frame_time: seconds between frames.
        positions: (T, J, 3) float64, each joint relative to its parent, in the parent's frame.
        rotations: (T, J, 3, 3) float64, relative to the parent.
    """

    name: str
    joint_names: tuple[str, ...]
    parents: np.ndarray
    offsets: np.ndarray
    frame_time: float
    positions: np.ndarray
    rotations: np.ndarray

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return (len(self) - 1) * self.frame_time

    def at(self, times: np.ndarray) -> Clip:
        """The clip at ``times``, (T',) seconds: linear in positions, on the shortest arc in rotations.

        The result's ``frame_time`` is the mean step of ``times``.

        Raises:
            InputError: a time is before the first frame or after the last.
        """
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        slack = 1e-3 * self.frame_time
        if len(times) == 0 or not (times.min() >= -slack and times.max() <= self.duration + slack):
            found = f"times from {times.min():.4g} s to {times.max():.4g} s" if len(times) else "no times"
            raise InputError(f"clip {self.name}", found, f"times from 0 s to {self.duration:.4g} s")
        place = np.clip(times / self.frame_time, 0, len(self) - 1)
        before = np.minimum(place.astype(np.int64), max(len(self) - 2, 0))
        after = np.minimum(before + 1, len(self) - 1)
        part = place - before
        first = Rotation.from_matrix(self.rotations[before].reshape(-1, 3, 3))
        turn = first.inv() * Rotation.from_matrix(self.rotations[after].reshape(-1, 3, 3))
        weights = np.repeat(part, len(self.parents))[:, None]
        rotations = (first * Rotation.from_rotvec(turn.as_rotvec() * weights)).as_matrix()
        step = part[:, None, None]
        frame_time = float(np.mean(np.diff(times))) if len(times) > 1 else self.frame_time
        positions = (1 - step) * self.positions[before] + step * self.positions[after]
        return replace(self, frame_time=frame_time, positions=positions,
                       rotations=rotations.reshape(len(times), -1, 3, 3))

    def forward(self) -> tuple[np.ndarray, np.ndarray]:
        """World rotations (T, J, 3, 3) and joint positions (T, J, 3)."""
        rotations, positions = self.rotations.copy(), self.positions.copy()
        for j, p in enumerate(self.parents):
            if p >= 0:
                rotations[:, j] = rotations[:, p] @ self.rotations[:, j]
                offset = np.einsum("tab,tb->ta", rotations[:, p], self.positions[:, j])
                positions[:, j] = positions[:, p] + offset
        return rotations, positions


def read_bvh(path: str | os.PathLike[str]) -> Clip:
    """Reads a BVH file with one root. Channels may be in any order, and any joint may have positions.

    Rotations are intrinsic, in the order of the channels; angles in the file are degrees.

    Raises:
        InputError: the file is missing or wrong; the message names the line.
    """
    reader = _Reader(Path(path))
    skeleton = _Skeleton()
    reader.expect("HIERARCHY")
    reader.expect("ROOT")
    _read_joints(reader, skeleton)
    reader.expect("MOTION")
    return _read_motion(reader, skeleton)


@dataclass
class _Skeleton:
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float]] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)


class _Reader:
    """Reads a file word by word and keeps track of the line; skips blank lines."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines = read_lines(path, "a BVH file")
        self.row = 0
        self.words: list[str] = []

    @property
    def where(self) -> str:
        return f"{self.path}, line {min(max(self.row, 1), max(len(self.lines), 1))}"

    def word(self, expected: str) -> str:
        while not self.words:
            if self.row >= len(self.lines):
                raise InputError(self.where, "the end of the file", expected, "the file is truncated")
            self.words = self.lines[self.row].split()
            self.row += 1
        return self.words.pop(0)

    def expect(self, word: str) -> None:
        found = self.word(word)
        if found.upper() != word.upper():
            raise InputError(self.where, repr(found), word)

    def number(self, expected: str) -> float:
        word = self.word(expected)
        try:
            value = float(word)
        except ValueError:
            raise InputError(self.where, repr(word), expected) from None
        if not math.isfinite(value):
            raise InputError(self.where, word, f"{expected}, finite")
        return value

    def count(self, expected: str, low: int, high: int) -> int:
        word = self.word(expected)
        if not (word.isdecimal() and len(word) < 10 and low <= int(word) <= high):
            raise InputError(self.where, repr(word), expected)
        return int(word)

    def rest(self, expected: str) -> str:
        """The remaining words of this line, joined."""
        first = self.word(expected)
        text = " ".join([first, *self.words])
        self.words = []
        return text


def _read_joints(reader: _Reader, skeleton: _Skeleton) -> None:
    """Reads the root, from its name to its closing brace, and all joints inside it."""
    open_joints = [_open_joint(reader, skeleton, -1)]
    while open_joints:
        joint = open_joints[-1]
        expected = f"CHANNELS, JOINT, End Site or }} of joint {skeleton.names[joint]}"
        match (word := reader.word(expected)).upper():
            case "}":
                open_joints.pop()
            case "CHANNELS":
                skeleton.channels[joint] = _read_channels(reader)
            case "JOINT":
                open_joints.append(_open_joint(reader, skeleton, joint))
            case "END":
                reader.expect("Site")
                reader.expect("{")
                _read_offset(reader)
                reader.expect("}")
            case _:
                raise InputError(reader.where, repr(word), expected)


def _open_joint(reader: _Reader, skeleton: _Skeleton, parent: int) -> int:
    """Reads a joint's name, opening brace and offset; returns its index."""
    name, brace, rest = reader.rest("a joint's name").partition("{")
    name = name.strip()
    if rest or not name:
        raise InputError(reader.where, repr(name + brace + rest), "a joint's name, then {")
    if name in skeleton.names:
        raise InputError(reader.where, f"a second joint {name!r}", "each name once")
    skeleton.names.append(name)
    skeleton.parents.append(parent)
    skeleton.channels.append([])
    if not brace:
        reader.expect("{")
    skeleton.offsets.append(_read_offset(reader))
    return len(skeleton.names) - 1


def _read_offset(reader: _Reader) -> list[float]:
    reader.expect("OFFSET")
    return [reader.number("three numbers after OFFSET") for _ in range(3)]


def _read_channels(reader: _Reader) -> list[str]:
    count = reader.count("a number of channels from 0 to 6", 0, 6)
    channels = [reader.word("a channel") for _ in range(count)]
    known = {c.lower(): c for c in _CHANNELS}
    for channel in channels:
        if channel.lower() not in known:
            raise InputError(reader.where, repr(channel), f"{count} of {', '.join(_CHANNELS)}")
    named = [known[c.lower()] for c in channels]
    if len(set(named)) < len(named):
        raise InputError(reader.where, " ".join(named), "each channel once")
    return named


def _read_motion(reader: _Reader, skeleton: _Skeleton) -> Clip:
    reader.expect("Frames:")
    count = reader.count("a number of frames above 0", 1, 10**9)
    reader.expect("Frame")
    reader.expect("Time:")
    frame_time = reader.number("the seconds of a frame")
    if frame_time <= 0:
        raise InputError(reader.where, str(frame_time), "a frame time above 0")
    width = sum(map(len, skeleton.channels))
    labels = [f"{name} {channel}"
              for name, own in zip(skeleton.names, skeleton.channels, strict=True) for channel in own]
    values = []  # grows with the file, whatever number of frames it claims
    for frame in range(count):
        words = reader.rest(f"frame {frame + 1} of {count}").split()
        if len(words) != width:
            raise InputError(reader.where, f"{len(words)} numbers", f"{width}, one for each channel")
        values.append(_numbers(reader.where, words, labels, frame + 1))
    positions, rotations = _decode(skeleton, np.array(values))
    return Clip(name=reader.path.stem, joint_names=tuple(skeleton.names),
                parents=np.array(skeleton.parents, dtype=np.int32), offsets=np.array(skeleton.offsets),
                frame_time=frame_time, positions=positions, rotations=rotations)


def _numbers(where: str, words: list[str], labels: list[str], frame: int) -> np.ndarray:
    """The numbers of a frame, one for each channel; an error names the joint and the channel."""
    row = np.full(len(words), np.nan)
    for i, word in enumerate(words):
        with contextlib.suppress(ValueError):
            row[i] = float(word)
        if not math.isfinite(row[i]):
            raise InputError(where, f"{word!r} for {labels[i]} in frame {frame}", "a finite number")
    return row


def _decode(skeleton: _Skeleton, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local positions (T, J, 3) and rotations (T, J, 3, 3) from the channels' values (T, C)."""
    count = len(values)
    positions = np.tile(np.array(skeleton.offsets), (count, 1, 1))
    rotations = np.tile(np.eye(3), (count, len(skeleton.names), 1, 1))
    at = 0
    for joint, channels in enumerate(skeleton.channels):
        moves = [at + i for i, channel in enumerate(channels) if channel.endswith("position")]
        # Some programs write position channels for all joints, and leave them at zero.
        used = joint == 0 or values[:, moves].any()
        for channel in channels:
            if at in moves:
                if used:
                    positions[:, joint, "XYZ".index(channel[0])] = values[:, at]
            else:
                turn = Rotation.from_euler(channel[0], values[:, at : at + 1], degrees=True).as_matrix()
                rotations[:, joint] = rotations[:, joint] @ turn
            at += 1
    return positions, rotations
