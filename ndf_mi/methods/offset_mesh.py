"""The textured mesh with offsets: a baseline whose vertices are fitted along with the texture."""

from __future__ import annotations

from typing import ClassVar

import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.methods.base import Budget, Progress
from ndf_mi.methods.mesh_record import RENDER_SPP, MeshRecord, SavedMesh
from ndf_mi.surface.offset_fit import fit_offsets
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.textured import TexturedSurface


class OffsetRecord(MeshRecord, forbid_unknown_fields=True, kw_only=True):
    """`mesh.json` of a mesh with offsets: `MeshRecord`, and

    Attributes:
        offset_rate: first step of the offsets, metres.
        offset_sweep: training loss that each first step tried had reached, keyed by the step as text.
        offset_median_mm, offset_max_mm: of the offsets' lengths over the vertices.
    """

    tuned: ClassVar[tuple[str, ...]] = ("rate", "offset_rate")

    offset_rate: float
    offset_sweep: dict[str, float] = {}
    offset_median_mm: float = 0.0
    offset_max_mm: float = 0.0

    @property
    def note(self) -> str:
        """One sentence on the rates, one on the offsets."""
        return (f"Learning rate {self.rate:g}, first step of the offsets {self.offset_rate:g} m. The offsets "
                f"are {self.offset_median_mm:.0f} mm in the median and at most {self.offset_max_mm:.0f} mm.")


class OffsetMesh(SavedMesh[OffsetRecord]):
    """The posed body, moved by one set of vertex offsets for all frames, emits a texture.

    The offsets belong to the body at rest and move with its skin: the clothed shape is learned, changes of
    its wrinkles with the pose are not. Topology and texture coordinates stay.

    Args:
        texture: texels a side of the square texture.
        rate: Adam's learning rate of the texture; None searches for the best.
        offset_rate: first step of the offsets, metres; None searches for the best.
    """

    key, label = "offset-mesh", "Mesh with offsets"
    kind = OffsetRecord

    def __init__(self, texture: int = 512, rate: float | None = None,
                 offset_rate: float | None = None) -> None:
        self._size = texture
        self._rate = rate
        self._offset_rate = offset_rate

    @property
    def offsets(self) -> np.ndarray:
        """(V, 3) float32 metres at rest."""
        return self._tensors["offsets"]

    def place(self, capture: Capture, size: int) -> None:
        """Makes the surface and the frames of the offsets."""
        self._surface, self._rest = TexturedSurface(capture, size), RestFrames(capture)

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Fits texture and offsets together."""
        self.place(capture, self._size)
        fitted = fit_offsets(self._surface, self._rest, capture, self._size, self._rate, self._offset_rate,
                             budget.seconds, budget.seed, progress)
        lengths = 1000 * np.linalg.norm(fitted.offsets, axis=1)
        self.keep(fitted.texture, budget, capture, fitted.search.seconds, offset_rate=fitted.search.rate,
                  offset_sweep=fitted.search.losses, offset_median_mm=float(np.median(lengths)),
                  offset_max_mm=float(lengths.max()))
        self._tensors["offsets"] = fitted.offsets

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background, `RENDER_SPP` samples a pixel."""
        self._surface.set_vertices(mi.Float(self._rest.posed(frame, self.offsets).ravel()))
        return self._surface.picture(camera, self._tensors["texture"], RENDER_SPP)
