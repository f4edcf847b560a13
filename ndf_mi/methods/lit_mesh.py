"""The textured mesh for relighting: a diffuse reflectance, fitted under one light and shown under any."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ndf_mi.body.box import BOX_PADDING, padded_box
from ndf_mi.capture.camera import Camera, box_pixels
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.methods.base import Budget, Light, Progress
from ndf_mi.methods.lit import noise_psnr
from ndf_mi.methods.lit_surface import LitSurface, ReflectanceFit
from ndf_mi.methods.mesh import RENDER_SPP
from ndf_mi.methods.mesh_record import MeshRecord, read_mesh, record_of, tensors_of, write_mesh
from ndf_mi.render.scene import lights as lights_of
from ndf_mi.surface.texture_fit import fit_texture


class RelightableMesh:
    """The posed body with a diffuse texture, path traced with interreflection, as synthetic captures are.

    Args:
        texture: texels a side.
        rate: Adam's learning rate; None searches for the best.
    """

    key, label = "mesh", "Diffuse mesh"

    def __init__(self, texture: int = 256, rate: float | None = None) -> None:
        self._size = texture
        self._rate = rate

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Fits the reflectance under the capture's own light, which must be known."""
        self._capture = capture
        surface = LitSurface(capture, self._size, lights_of(capture.known_lighting()))
        fitted = fit_texture(surface, capture, self._size, self._rate, budget.seconds, budget.seed, progress,
                             make=ReflectanceFit)
        self._record, self._tensors = record_of(MeshRecord, fitted, budget, capture), tensors_of(fitted)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes `mesh.json`, `mesh.safetensors`, and `texture.png` to look at."""
        write_mesh(folder, self._record, self._tensors)

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads what `save` wrote.

        Raises:
            InputError: as `read_mesh`.
        """
        self._capture = capture
        self._record, self._tensors = read_mesh(folder, MeshRecord, capture)

    def metadata(self) -> dict[str, Any]:
        """The members of `MeshRecord`, and keys that `methods.base` lists."""
        return {**self._record.metadata("rate"), "note": f"Learning rate {self._record.rate:g}."}

    def under(self, light: Light, frames: Sequence[int], spp: int) -> LitMesh:
        """The mesh in some light; arguments as in `Relightable.under`."""
        return LitMesh(self._capture, self._tensors["texture"], light, spp, self.metadata())


class LitMesh:
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
        self._poses = capture.poses
        self._texture = texture
        self._light = light
        self._spp = spp
        self._metadata = {**metadata, "spp": spp}
        self._surface = LitSurface(capture, len(texture), light.emitters)
        self._noise: float | None = None

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background."""
        self._surface.set_frame(frame)
        self._surface.set_texture(mi.TensorXf(srgb_to_linear(self._texture)))
        low, high = padded_box(self._poses.vertices[self._poses.index(frame)], BOX_PADDING)
        image, noise = self._surface.lit_picture(camera, box_pixels(camera, low, high), self._spp, frame)
        self._noise = noise
        return image

    def metadata(self) -> dict[str, Any]:
        """That of the mesh, samples a pixel, and `noise_psnr` of the last picture rendered."""
        return {**self._metadata, **noise_psnr(self._noise)}

    def cache_key(self) -> str:
        """SHA-256 (hex) over texture, light, capture and samples a pixel."""
        mesh = hashlib.sha256(f"{RENDER_SPP} {self._metadata['capture']}".encode() + self._texture.tobytes())
        return hashlib.sha256(f"{self._light.name} {self._spp} {mesh.hexdigest()}".encode()).hexdigest()
