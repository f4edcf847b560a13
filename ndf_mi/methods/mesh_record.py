"""A trained mesh on disk: `mesh.json`, `mesh.safetensors`, and `texture.png` to look at."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, TypeVar

import mitsuba as mi
import msgspec
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from ndf_mi import files
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.methods.base import Budget
from ndf_mi.surface.texture_fit import FittedTexture

VERSION = 1


class MeshRecord(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """`mesh.json`: how a mesh was trained.

    Attributes:
        version: of the format.
        size: texels a side.
        rate: Adam's first learning rate of the texture, in sRGB units a step.
        sweep: training loss that each rate tried had reached, keyed by the rate as text; empty if it was
            given.
        sweep_seconds: wall-clock seconds of all searches; not part of `seconds`.
        budget: seconds that were given; None for training to convergence.
        seconds, steps: wall-clock seconds and steps of training.
        converged: whether training ended because the loss stopped falling.
        seen: share of the texels that training images touched.
        seed: of the order of images and of the samples.
        capture: digest of the capture.
        history: [step, seconds, loss], means over windows; the loss is the sRGB mean squared error in the
            rectangle of the body.
    """

    version: int = VERSION
    size: int
    rate: float
    sweep: dict[str, float] = {}
    sweep_seconds: float = 0.0
    budget: float | None = None
    seconds: float = 0.0
    steps: int = 0
    converged: bool = False
    seen: float = 0.0
    seed: int = 0
    capture: str = ""
    history: list[tuple[int, float, float]] = []


R = TypeVar("R", bound=MeshRecord)


def record_of(kind: type[R], fitted: FittedTexture, budget: Budget, capture: Capture,
              sweep_seconds: float = 0.0, **more: Any) -> R:
    """The record of a fit.

    Args:
        kind: the kind of record.
        fitted: the texture.
        budget, capture: those of `Method.fit`.
        sweep_seconds: of other searches than the texture's.
        more: the members that `kind` adds to `MeshRecord`.
    """
    rate, training = fitted.search, fitted.training
    return kind(
        size=len(fitted.texture), rate=rate.rate, sweep=rate.losses,
        sweep_seconds=rate.seconds + sweep_seconds,
        budget=budget.seconds, seconds=training.seconds, steps=training.steps, converged=training.converged,
        seen=float(fitted.seen.mean()), seed=budget.seed, capture=capture.digest, history=training.history,
        **more)


def metadata_of(record: MeshRecord, tuned: tuple[str, ...] = ("rate",)) -> dict[str, Any]:
    """A record as a method's metadata; `tuned` names the members that a search has found."""
    known = msgspec.to_builtins(record)
    del known["version"]
    return {**known, "options": {"texture": record.size}, "tuned": {name: known[name] for name in tuned}}


def write_mesh(folder: str | os.PathLike[str], record: MeshRecord, tensors: dict[str, np.ndarray]) -> None:
    """Writes a mesh.

    Args:
        folder: where to.
        record: for `mesh.json`.
        tensors: `texture` (size, size, 3) float32 sRGB, `seen` (size, size) uint8, and the method's own.
    """
    folder = Path(folder)
    with files.replacing(folder / "texture.png") as beside:
        mi.Bitmap(np.round(np.clip(tensors["texture"], 0, 1) * 255).astype(np.uint8)).write(str(beside))
    with files.replacing(folder / "mesh.safetensors") as beside:
        beside.write_bytes(save(tensors))
    files.write_json(folder / "mesh.json", msgspec.to_builtins(record))


def read_record(folder: str | os.PathLike[str], kind: type[R], capture: Capture) -> R:
    """Reads `mesh.json`.

    Raises:
        InputError: it is missing, has an entry of the wrong kind or range, or is of another version or
            capture.
    """
    file = Path(folder) / "mesh.json"
    expected = f"a mesh of version {VERSION} as `ndf-mi compare` writes it"
    try:
        record = msgspec.json.decode(file.read_bytes(), type=kind)
    except (OSError, msgspec.MsgspecError) as error:
        raise InputError(file, str(error), expected) from None
    if record.version != VERSION:
        raise InputError(f"{file}: version", str(record.version), str(VERSION))
    if record.size < 1 or not record.rate > 0:
        raise InputError(f"{file}: size, rate", f"{record.size}, {record.rate}",
                         "a whole number and a number, both above 0")
    if record.capture != capture.digest:
        raise InputError(f"{file}: capture", f"the digest {record.capture[:12]}",
                         f"{capture.digest[:12]}, that of {capture.path}")
    return record


def read_tensors(folder: str | os.PathLike[str],
                 shapes: dict[str, tuple[type[np.generic], tuple[int, ...]]]) -> dict[str, np.ndarray]:
    """Reads `mesh.safetensors`.

    Args:
        folder: of the mesh.
        shapes: type and shape of each tensor, by its name.

    Raises:
        InputError: the file is missing or damaged, or a tensor has another type or shape.
    """
    file = Path(folder) / "mesh.safetensors"
    try:
        tensors = load_file(file)
    except (OSError, SafetensorError) as error:
        raise InputError(file, str(error), "the tensors of a mesh as `ndf-mi compare` writes them") from None
    for name, (kind, shape) in shapes.items():
        found = tensors.get(name)
        if found is None or (found.dtype, found.shape) != (np.dtype(kind), shape):
            what = "nothing" if found is None else f"{found.dtype} of shape {found.shape}"
            raise InputError(f"{file}: {name}", what, f"{np.dtype(kind)} of shape {shape}")
    return {name: tensors[name] for name in shapes}


def texture_shapes(size: int) -> dict[str, tuple[type[np.generic], tuple[int, ...]]]:
    """Type and shape of the tensors that every mesh has, for `read_tensors`."""
    return {"texture": (np.float32, (size, size, 3)), "seen": (np.uint8, (size, size))}
