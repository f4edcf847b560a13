"""The textured mesh: the posed body with one texture for all frames, a baseline without a neural field."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.methods.base import Budget, Progress
from ndf_mi.methods.mesh_record import RENDER_SPP, MeshRecord, SavedMesh
from ndf_mi.surface.texture_fit import fit_texture
from ndf_mi.surface.textured import TexturedSurface


class TexturedMesh(SavedMesh[MeshRecord]):
    """The body emits the texture. It shows nothing off the body's surface, nor changes with pose or view.

    Args:
        texture: texels a side of the square texture.
        rate: Adam's learning rate; None searches for the best.
    """

    key, label = "mesh", "Mesh"
    kind = MeshRecord

    def __init__(self, texture: int = 512, rate: float | None = None) -> None:
        self._size = texture
        self._rate = rate

    def place(self, capture: Capture, size: int) -> None:
        """Makes the surface."""
        self._surface = TexturedSurface(capture, size)

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Fits the texture by Adam on the sRGB mean squared error, one random frame a step."""
        self.place(capture, self._size)
        self.keep(fit_texture(self._surface, capture, self._size, self._rate, budget.seconds, budget.seed,
                              progress), budget, capture)

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background, `RENDER_SPP` samples a pixel."""
        self._surface.set_frame(frame)
        return self._surface.picture(camera, self._tensors["texture"], RENDER_SPP)
