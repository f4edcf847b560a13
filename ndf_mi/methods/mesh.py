"""The textured mesh: the posed body with one texture for all frames, optimised through Mitsuba."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from ndf_mi import files
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.surface.texture import fill_unseen
from ndf_mi.surface.texture_fit import Progress, TextureFit, best_rate
from ndf_mi.surface.textured import TexturedSurface

if TYPE_CHECKING:
    from typing_extensions import Self

RENDER_SPP = 64
_VERSION = 1


@dataclass
class MeshFacts:
    """What is known of a fit: settings, the sweep over learning rates, and how training went.

    Attributes:
        size: texels a side.
        rate: Adam's first learning rate, in sRGB units a step.
        sweep: training loss reached by each rate tried, keyed by the rate as text.
        sweep_seconds: time of the sweep; not part of `seconds`.
        budget: the wall-clock time given in seconds, None for training to convergence; decoding the images is not part of it.
        seconds, steps: time and steps of training.
        converged: whether training ended because the loss stopped falling.
        seen: the share of texels that training images have coloured.
        seed: of the order of images and of the samples.
        capture: digest of the capture trained on.
        history: (step, seconds, loss) means over windows; the loss is the sRGB MSE in the body's rectangle.
    """

    size: int
    rate: float = 0.0
    sweep: dict[str, float] = field(default_factory=dict)
    sweep_seconds: float = 0.0
    budget: float | None = None
    seconds: float = 0.0
    steps: int = 0
    converged: bool = False
    seen: float = 0.0
    seed: int = 0
    capture: str = ""
    history: list[tuple[int, float, float]] = field(default_factory=list)


class TexturedMesh:
    """Baseline: what a Mitsuba user would do without a neural field.

    The texture is kept sRGB-encoded, because the loss is taken there, and decoded to linear radiance for rendering. It
    is at least 0 and not bounded above. It can't show anything off the body's surface, nor anything that changes with
    pose or view.

    Args:
        capture: whose body, poses and background it renders.
        size: texels a side of the square texture.
        rate: Adam's learning rate; None finds the best of a sweep when `fit` is called.
    """

    facts_type: type[MeshFacts] = MeshFacts

    def __init__(self, capture: Capture, size: int = 512, rate: float | None = None) -> None:
        self.name = "mesh"
        self._surface = TexturedSurface(capture, size)
        self._facts = MeshFacts(size=size, rate=rate or 0.0)
        self.texture = np.full((size, size, 3), 0.5, dtype=np.float32)
        self.seen = np.zeros((size, size), dtype=bool)

    def fit(
        self, capture: Capture, seconds: float | None = None, seed: int = 0, progress: Progress | None = None
    ) -> None:
        """Optimises the texture on the `train` split by Adam on the sRGB mean squared error, a random frame each step.

        Args:
            capture: with a `train` split.
            seconds: wall-clock budget, with a rate that decays over it; None trains until the loss stops falling. The clock starts
                when all images are in memory, as that of a field's training does.
            seed: of the order of images and of the samples.
            progress: called after each step with (seconds, step, loss).
        """
        facts = self._facts
        if not facts.rate:
            facts.rate, facts.sweep, facts.sweep_seconds = best_rate(self._surface, capture, facts.size, seed)
        self._train(TextureFit(self._surface, capture, facts.size, facts.rate, seed), capture, seconds, seed, progress)

    def _train(
        self, fit: TextureFit, capture: Capture, seconds: float | None, seed: int, progress: Progress | None
    ) -> None:
        """Runs a fit, takes its texture and notes how it went."""
        facts = self._facts
        facts.converged = fit.for_seconds(seconds, progress) if seconds is not None else fit.to_convergence(progress)
        self.seen = fit.seen()
        self.texture = fill_unseen(fit.texture(), self.seen)
        facts.budget, facts.seed, facts.capture = seconds, seed, capture.digest
        facts.seen = float(self.seen.mean())
        facts.seconds, facts.steps, facts.history = fit.seconds, fit.steps, fit.history

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background, `RENDER_SPP` samples a pixel."""
        self._pose(frame)
        self._surface.set_texture(mi.TensorXf(srgb_to_linear(self.texture)))
        with dr.suspend_grad():
            image = linear_to_srgb(self._surface.render(camera, RENDER_SPP, seed=0)).numpy()
        return np.clip(image, 0, 1)

    def _pose(self, frame: int) -> None:
        """Puts the surface where it is in a frame."""
        self._surface.set_frame(frame)

    def facts(self) -> dict[str, Any]:
        """The facts (`facts_type`) as a dictionary."""
        return asdict(self._facts)

    def fingerprint(self) -> str:
        """SHA-256 (hex) over what is rendered, the samples a pixel and the capture: equal ones give equal images."""
        state = hashlib.sha256(f"{RENDER_SPP} {self._facts.capture}".encode())
        for name, values in self.tensors().items():
            if name != "seen":
                state.update(values.tobytes())
        return state.hexdigest()

    def tensors(self) -> dict[str, np.ndarray]:
        """What is stored: `texture` (size, size, 3) float32 sRGB, `seen` (size, size) uint8."""
        return {"texture": self.texture, "seen": self.seen.astype(np.uint8)}

    def _restore(self, tensors: dict[str, np.ndarray]) -> None:
        self.texture, self.seen = tensors["texture"], tensors["seen"].astype(bool)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes `mesh.json`, `mesh.safetensors` (`tensors`) and `texture.png`, to look at, into the folder."""
        folder = Path(path)
        tensors = save(self.tensors())
        with files.replacing(folder / "texture.png") as beside:
            mi.Bitmap(np.round(np.clip(self.texture, 0, 1) * 255).astype(np.uint8)).write(str(beside))
        with files.replacing(folder / "mesh.safetensors") as beside:
            beside.write_bytes(tensors)
        files.write_json(folder / "mesh.json", {"version": _VERSION, **self.facts()})

    @classmethod
    def load(cls, path: str | os.PathLike[str], capture: Capture) -> Self:
        """Reads the folder `path`.

        Raises:
            InputError: a file is missing, damaged, or of another version.
        """
        folder = Path(path)
        document = _read_json(folder / "mesh.json", cls.facts_type)
        mesh = cls(capture, size=document["size"], rate=document["rate"])
        mesh._facts = cls.facts_type(**{key: value for key, value in document.items() if key != "version"})
        file = folder / "mesh.safetensors"
        try:
            tensors = load_file(file)
        except (OSError, SafetensorError) as error:
            raise InputError(file, str(error), "a texture as `ndf-mi compare` writes it") from error
        for name, values in mesh.tensors().items():
            found = tensors.get(name)
            if found is None or (found.shape, found.dtype) != (values.shape, values.dtype):
                what = "nothing" if found is None else f"{found.dtype} of shape {found.shape}"
                raise InputError(f"{file}: {name}", what, f"{values.dtype} of shape {values.shape}")
        mesh._restore(tensors)
        return mesh


def _read_json(file: Path, facts_type: type[MeshFacts]) -> dict[str, Any]:
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(file, str(error), "a JSON file as `ndf-mi compare` writes it") from error
    keys = {"version", *facts_type.__dataclass_fields__}
    if not isinstance(document, dict) or document.get("version") != _VERSION or set(document) != keys:
        found = document.get("version") if isinstance(document, dict) else type(document).__name__
        raise InputError(file, f"version {found}", f"version {_VERSION} with {', '.join(sorted(keys))}")
    size, rate = document["size"], document["rate"]
    if not (isinstance(size, int) and size > 0 and isinstance(rate, (int, float)) and rate > 0):
        raise InputError(f"{file}: size, rate", f"{size!r}, {rate!r}", "a whole number and a number, above 0")
    return document
