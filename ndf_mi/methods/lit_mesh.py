"""The textured mesh for relighting: a diffuse reflectance, fitted under one light and shown under any."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.methods.base import Budget, Light, Progress
from ndf_mi.methods.lit import LitPerformer, LitRenderer
from ndf_mi.methods.lit_surface import DEPTH, LitSurface
from ndf_mi.methods.mesh_record import MeshRecord, SavedMesh, mesh_key
from ndf_mi.render.scene import lights as lights_of
from ndf_mi.surface.texture_fit import fit_texture


class RelightableMesh(SavedMesh[MeshRecord]):
    """The posed body with a diffuse texture, path traced with interreflection, as synthetic captures are.

    Args:
        texture: texels a side.
        rate: Adam's learning rate; None searches for the best.
    """

    key, label = "mesh", "Diffuse mesh"
    kind = MeshRecord

    def __init__(self, texture: int = 256, rate: float | None = None) -> None:
        self._size = texture
        self._rate = rate

    def place(self, capture: Capture, size: int) -> None:
        """Keeps the capture, for `under`."""
        self._capture = capture

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Fits the reflectance under the capture's own light, which must be known."""
        self.place(capture, self._size)
        surface = LitSurface(capture, self._size, lights_of(capture.known_lighting()))
        self.keep(fit_texture(surface, capture, self._size, self._rate, budget.seconds, budget.seed,
                              progress), budget, capture)

    def under(self, light: Light, frames: Sequence[int], spp: int) -> LitMesh:
        """The mesh in some light; arguments as in `Relightable.under`."""
        return LitMesh(self._capture, self._tensors["texture"], light, spp, self.metadata())


class LitMesh(LitPerformer):
    """A mesh of a known reflectance in some light.

    Args:
        capture: whose body, poses and background it has.
        texture: (size, size, 3) sRGB-encoded reflectance.
        light: what lights the scene.
        spp: samples a pixel, an even number.
        metadata: of the mesh.
    """

    key, label = RelightableMesh.key, RelightableMesh.label

    def __init__(self, capture: Capture, texture: np.ndarray, light: Light, spp: int,
                 metadata: dict[str, Any]) -> None:
        super().__init__(capture.poses, 0.0, {**metadata, "spp": spp})
        self._surface = LitSurface(capture, len(texture), light.emitters)
        self._surface.set_texture(mi.TensorXf(srgb_to_linear(texture)))
        self._renderer = LitRenderer(self._surface.scene, mi.load_dict({"type": "path", **DEPTH}),
                                     capture.background, spp)
        mesh = mesh_key(metadata["capture"], texture)
        self._key = hashlib.sha256(f"{light.name} {spp} {mesh}".encode()).hexdigest()

    def place(self, camera: Camera, frame: int) -> LitRenderer:
        """The renderer, with the mesh at `frame`."""
        self._surface.set_frame(frame)
        return self._renderer

    def cache_key(self) -> str:
        """SHA-256 (hex) over texture, light, capture and samples a pixel."""
        return self._key
