"""The textured mesh: the posed body with one texture for all frames, a baseline without a neural field."""

from __future__ import annotations

import hashlib
import os
from typing import Any

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.methods.base import Budget, Progress
from ndf_mi.methods.mesh_record import MeshRecord, read_mesh, record_of, tensors_of, write_mesh
from ndf_mi.surface.texture_fit import fit_texture
from ndf_mi.surface.textured import TexturedSurface

RENDER_SPP = 64


class TexturedMesh:
    """The body emits the texture. It shows nothing off the body's surface, nor changes with pose or view.

    Args:
        texture: texels a side of the square texture.
        rate: Adam's learning rate; None searches for the best.
    """

    key, label = "mesh", "Mesh"

    def __init__(self, texture: int = 512, rate: float | None = None) -> None:
        self._size = texture
        self._rate = rate

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Fits the texture by Adam on the sRGB mean squared error, one random frame a step."""
        self._surface = TexturedSurface(capture, self._size)
        fitted = fit_texture(self._surface, capture, self._size, self._rate, budget.seconds, budget.seed,
                             progress)
        self._record, self._tensors = record_of(MeshRecord, fitted, budget, capture), tensors_of(fitted)

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background, `RENDER_SPP` samples a pixel."""
        self._surface.set_frame(frame)
        return self._surface.picture(camera, self._tensors["texture"], RENDER_SPP)

    def metadata(self) -> dict[str, Any]:
        """The members of `MeshRecord`, and keys that `methods.base` lists."""
        return {**self._record.metadata("rate"), "note": f"Learning rate {self._record.rate:g}."}

    def cache_key(self) -> str:
        """SHA-256 (hex) over texture, capture and samples a pixel."""
        state = hashlib.sha256(f"{RENDER_SPP} {self._record.capture}".encode())
        state.update(self._tensors["texture"].tobytes())
        return state.hexdigest()

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes `mesh.json`, `mesh.safetensors`, and `texture.png` to look at."""
        write_mesh(folder, self._record, self._tensors)

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads what `save` wrote.

        Raises:
            InputError: as `read_mesh`.
        """
        self._record, self._tensors = read_mesh(folder, MeshRecord, capture)
        self._surface = TexturedSurface(capture, self._record.size)
