"""The settings of a rendering by quadrature: everything that can be changed without training again."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from typing import Any

import drjit as dr
import numpy as np
from skimage.transform import resize

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.model import networks_here
from ndf_mi.render.image import RECIPE, Image, ImageRenderer
from ndf_mi.run import Run


@dataclass(frozen=True)
class Setting:
    """How an image of a run is rendered.

    Attributes:
        samples: candidate samples per ray.
        cutoff: early termination: a ray is followed until its transmittance falls to this, in [0, 1); 0
            follows it to its end.
        spp: rays per pixel.
        stratified: shift each ray's samples at random instead of taking the middle of each interval.
        networks: one of `ndf_mi.model.NETWORKS`.
        size: fraction of the camera's width and height to render at, in (0, 1]; the image is then enlarged
            bilinearly in sRGB.

    Raises:
        InputError: a value is out of range, or this machine does not have the networks.
    """

    samples: int = 128
    cutoff: float = 1e-4
    spp: int = 1
    stratified: bool = False
    networks: str = "auto"
    size: float = 1.0

    def __post_init__(self) -> None:
        self.renderer()
        if self.networks not in networks_here():
            raise InputError("networks", repr(self.networks), "one of " + ", ".join(networks_here()))
        if not 0 < self.size <= 1:
            raise InputError("size", f"{self.size:g}", "a fraction in (0, 1]")

    def renderer(self) -> ImageRenderer:
        """The renderer with these settings."""
        return ImageRenderer(self.samples, spp=self.spp, cutoff=self.cutoff, stratified=self.stratified)

    def image(self, run: Run, frame: int, camera: Camera, geometry: bool = False) -> Image:
        """The image at the resolution that is rendered. The body is posed again, as for each frame of a
        video."""
        row = run.poses.index(frame)
        posed = run.posed_as(run.poses.vertices[row], run.poses.pose[row], self.networks)
        return self.renderer()(posed, self.camera(camera), geometry)

    def camera(self, camera: Camera) -> Camera:
        """The camera at the resolution that is rendered."""
        if self.size == 1:
            return camera
        return camera.scaled(*(max(round(self.size * side), 1) for side in (camera.w, camera.h)))

    def picture(self, run: Run, frame: int, camera: Camera) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the run's background, at the camera's full resolution."""
        picture = self.image(run, frame, camera).over(run.background)
        if picture.shape[:2] != (camera.h, camera.w):
            size = (camera.h, camera.w)
            picture = resize(picture, size, order=1, mode="edge", anti_aliasing=False).astype(np.float32)
        dr.sync_thread()
        return picture

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self)


#: Samples per ray of a converged image: eight times the default.
CONVERGED_SAMPLES = 1024


def converged(spp: int = 1) -> Setting:
    """The limit of settings with `spp` rays per pixel: many samples, and every ray followed to its end.

    The rays per pixel are not part of the limit. Fields are trained through pixel centres, so whether more
    rays improve an image can only be judged against photographs, not against the field itself.
    """
    return Setting(CONVERGED_SAMPLES, cutoff=0.0, spp=spp)


def field_digest(run: Run) -> str:
    """SHA-256 (hex) of a field's architecture, parameters and surface and of the rendering recipe: runs with
    the same digest render the same images at the same settings."""
    state = hashlib.sha256(f"{RECIPE} {sorted(run.model.field.preset.to_dict().items())}".encode())
    for name, values in sorted(run.tensors().items()):
        state.update(name.encode() + values.tobytes())
    return state.hexdigest()
