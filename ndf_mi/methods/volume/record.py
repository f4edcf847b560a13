"""Trained volumes on disk: `volume.safetensors`, and `volume.json` with how they were trained."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.learn.state import read_state

VERSION = 1
FILE_NAME = "volume.json"
TENSORS = "volume.safetensors"

Tensors = dict[str, np.ndarray]
"""Parameters by name, flat float32, and `offsets` (V, 3) float32 metres where the surface has them."""


class VolumeRecord(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """`volume.json`: how a volume was trained.

    Attributes:
        version: of the format.
        method: the method's key.
        preset: all options of the preset.
        capture: digest of the capture.
        seed: of parameters, rays and jitter.
        budget: seconds that were given; None for the preset's steps.
        seconds, steps: wall-clock seconds of training, the surface's included, and steps.
        surface_seconds: what fitting the surface took.
        refused: steps that were not taken because something was not finite.
        history: [step, seconds, smoothed mean squared error in sRGB of the rays drawn].
        more: what a method adds.
    """

    version: int = VERSION
    method: str
    preset: dict[str, Any]
    capture: str
    seed: int
    budget: float | None = None
    seconds: float = 0.0
    steps: int = 0
    surface_seconds: float = 0.0
    refused: int = 0
    history: list[tuple[int, float, float]] = []
    more: dict[str, Any] = {}

    def same_training(self, other: VolumeRecord) -> bool:
        """Whether the other is a training of the same method, preset, capture, seed and budget."""
        names = ("method", "preset", "capture", "seed", "budget")
        return all(getattr(self, name) == getattr(other, name) for name in names)


def write_volume(folder: str | os.PathLike[str], record: VolumeRecord, tensors: Tensors) -> None:
    """Writes both files, `volume.json` last."""
    folder = Path(folder)
    with files.replacing(folder / TENSORS) as temporary:
        temporary.write_bytes(save(tensors))
    files.write_json(folder / FILE_NAME, msgspec.to_builtins(record))


def read_record(folder: str | os.PathLike[str]) -> VolumeRecord:
    """Reads `volume.json`.

    Raises:
        InputError: it is missing, damaged or of another version.
    """
    file = Path(folder) / FILE_NAME
    try:
        record = msgspec.json.decode(file.read_bytes(), type=VolumeRecord)
    except FileNotFoundError:
        raise InputError(file, "no such file", "a volume as `ndf-mi compare` writes it") from None
    except (OSError, msgspec.MsgspecError) as error:
        raise InputError(file, str(error), "a volume as `ndf-mi compare` writes it") from None
    if record.version != VERSION:
        raise InputError(f"{file}: version", str(record.version), str(VERSION))
    return record


def read_volume(folder: str | os.PathLike[str], method: str, capture: Capture
                ) -> tuple[VolumeRecord, Tensors]:
    """Reads what `write_volume` wrote.

    Raises:
        InputError: a file is missing or damaged, or it is of another method or capture.
    """
    record = read_record(folder)
    file = Path(folder) / FILE_NAME
    if record.method != method:
        raise InputError(f"{file}: method", repr(record.method), repr(method))
    if record.capture != capture.digest:
        raise InputError(f"{file}: capture", f"the digest {record.capture[:12]}",
                         f"{capture.digest[:12]}, that of {capture.path}")
    file = Path(folder) / TENSORS
    try:
        tensors = load_file(file)
    except FileNotFoundError:
        raise InputError(file, "no such file", "the tensors of a volume") from None
    except (OSError, SafetensorError) as error:
        raise InputError(file, str(error), "the tensors of a volume") from None
    if "offsets" in tensors:
        expect_shape(f"{file}: offsets", tensors["offsets"], capture.poses.vertices.shape[1:])
    return record, tensors


def read_checkpoint(file: Path, record: VolumeRecord) -> tuple[Tensors, dict[str, Any]] | None:
    """Tensors and metadata, with a `record`, of a stopped training like `record`'s; None if there is none."""
    try:
        tensors, metadata = read_state(file)
        known = msgspec.convert(metadata["record"], VolumeRecord)
    except (InputError, KeyError, msgspec.ValidationError):
        return None
    return (tensors, metadata) if known.same_training(record) else None


def expect_shape(where: str, found: np.ndarray | None, shape: tuple[int, ...]) -> None:
    """Raises InputError unless `found` is float32 of this shape."""
    if found is None or (found.dtype, found.shape) != (np.float32, shape):
        what = "nothing" if found is None else f"{found.dtype} of shape {found.shape}"
        raise InputError(where, what, f"float32 of shape {shape}")
