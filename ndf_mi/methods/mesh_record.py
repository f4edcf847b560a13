"""Trained meshes: their record, and their files."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

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

RENDER_SPP = 64
"""Samples a pixel of the pictures of meshes that emit their texture."""

Tensors = dict[str, np.ndarray]
"""`texture` (size, size, 3) float32 sRGB, `seen` (size, size) uint8, and what a method adds."""


class MeshRecord(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """`mesh.json`: how a mesh was trained.

    Attributes:
        tuned: names of the members that a search may have found.
        version: of the format.
        size: texels a side.
        rate: Adam's first learning rate of the texture, in sRGB units a step.
        sweep: training loss that each rate tried had reached, keyed by the rate as text; empty if given.
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

    tuned: ClassVar[tuple[str, ...]] = ("rate",)

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

    @property
    def note(self) -> str:
        """One sentence for the report."""
        return f"Learning rate {self.rate:g}."

    def metadata(self) -> dict[str, Any]:
        """The members, and keys that `methods.base` lists."""
        known = {name: getattr(self, name) for name in self.__struct_fields__ if name != "version"}
        tuned = {name: known[name] for name in self.tuned}
        return {**known, "options": {"texture": self.size}, "tuned": tuned, "note": self.note}


R = TypeVar("R", bound=MeshRecord)


class SavedMesh(Generic[R]):
    """What the mesh methods share: how they are kept, described and identified."""

    kind: type[R]
    _record: R
    _tensors: Tensors

    def place(self, capture: Capture, size: int) -> None:
        """Prepares what shows the body of a capture with a texture of `size` texels a side."""
        raise NotImplementedError

    def keep(self, fitted: FittedTexture, budget: Budget, capture: Capture, sweep_seconds: float = 0.0,
             **more: Any) -> None:
        """Takes over a fit; `more` are the members that `kind` adds, `sweep_seconds` their searches' time."""
        rate, training = fitted.search, fitted.training
        self._record = self.kind(
            size=len(fitted.texture), rate=rate.rate, sweep=rate.losses,
            sweep_seconds=rate.seconds + sweep_seconds, budget=budget.seconds,
            seconds=training.seconds, steps=training.steps, converged=training.converged,
            seen=float(fitted.seen.mean()), seed=budget.seed, capture=capture.digest,
            history=training.history, **more)
        self._tensors = {"texture": fitted.texture, "seen": fitted.seen.astype(np.uint8)}

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes `mesh.safetensors`, `texture.png` to look at, and `mesh.json` last."""
        folder, texture = Path(folder), self._tensors["texture"]
        with files.replacing(folder / "texture.png") as temporary:
            mi.Bitmap(np.round(np.clip(texture, 0, 1) * 255).astype(np.uint8)).write(str(temporary))
        with files.replacing(folder / "mesh.safetensors") as temporary:
            temporary.write_bytes(save(self._tensors))
        files.write_json(folder / "mesh.json", msgspec.to_builtins(self._record))

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads what `save` wrote.

        Raises:
            InputError: as `read_mesh`.
        """
        self._record, self._tensors = read_mesh(folder, self.kind, capture)
        self.place(capture, self._record.size)

    def metadata(self) -> dict[str, Any]:
        """The members of the record, and keys that `methods.base` lists."""
        return self._record.metadata()

    def cache_key(self) -> str:
        """SHA-256 (hex) over texture, offsets, capture and samples a pixel."""
        tensors = [self._tensors[name] for name in ("texture", "offsets") if name in self._tensors]
        return mesh_key(self._record.capture, *tensors)


def mesh_key(capture: str, *tensors: np.ndarray) -> str:
    """SHA-256 (hex) over samples a pixel, the digest of a capture, and what was fitted to it."""
    state = hashlib.sha256(f"{RENDER_SPP} {capture}".encode())
    for tensor in tensors:
        state.update(tensor.tobytes())
    return state.hexdigest()


def read_mesh(folder: str | os.PathLike[str], kind: type[R], capture: Capture) -> tuple[R, Tensors]:
    """Reads a mesh. A record with offsets comes with the tensor `offsets`, (V, 3) float32.

    Raises:
        InputError: a file is missing, an entry or a tensor has the wrong kind, shape or range, or the mesh is
            of another version or was trained on another capture.
    """
    file, expected = Path(folder) / "mesh.json", "as `ndf-mi compare` writes it"
    try:
        record = msgspec.json.decode(file.read_bytes(), type=kind)
        if record.version != VERSION:
            raise InputError(f"{file}: version", str(record.version), str(VERSION))
        if record.size < 1 or not record.rate > 0:
            raise InputError(f"{file}: size, rate", f"{record.size}, {record.rate}", "numbers above 0")
        if record.capture != capture.digest:
            raise InputError(f"{file}: capture", f"the digest {record.capture[:12]}",
                             f"{capture.digest[:12]}, that of {capture.path}")
        file = Path(folder) / "mesh.safetensors"
        tensors = load_file(file)
    except FileNotFoundError:
        raise InputError(file, "no such file", f"a mesh {expected}") from None
    except (OSError, msgspec.MsgspecError, SafetensorError) as error:
        raise InputError(file, str(error), f"a mesh {expected}") from None
    shapes: dict[str, tuple[str, tuple[int, ...]]] = {
        "texture": ("float32", (record.size, record.size, 3)), "seen": ("uint8", (record.size, record.size))}
    if "offset_rate" in kind.__struct_fields__:
        shapes["offsets"] = ("float32", capture.poses.vertices.shape[1:])
    for name, (dtype, shape) in shapes.items():
        found = tensors.get(name)
        if found is None or (str(found.dtype), found.shape) != (dtype, shape):
            what = "nothing" if found is None else f"{found.dtype} of shape {found.shape}"
            raise InputError(f"{file}: {name}", what, f"{dtype} of shape {shape}")
    return record, tensors
