"""One way to draw a run by quadrature, and drawing it: all that may be turned without training anew."""

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
    """How a picture is made.

    Attributes:
        samples: candidate samples a ray.
        cutoff: early termination: transmittance up to which a ray is followed, in [0, 1); 0 follows it to its end.
        spp: rays a pixel.
        stratified: a random shift of each ray's samples in place of strata's middles.
        networks: one of `ndf_mi.model.NETWORKS`.
        size: share of the camera's width and height that is rendered, in (0, 1]; the picture is then enlarged, bilinearly in sRGB.
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
            raise InputError("size", f"{self.size:g}", "a share in (0, 1]")

    def renderer(self) -> ImageRenderer:
        """What renders so."""
        return ImageRenderer(self.samples, spp=self.spp, cutoff=self.cutoff, stratified=self.stratified)

    def image(self, run: Run, frame: int, camera: Camera, geometry: bool = False) -> Image:
        """The image on the pixels that are rendered, from the body's vertices on: posing it is part of what a frame takes."""
        row = run.poses.index(frame)
        posed = run.posed_as(run.poses.vertices[row], run.poses.pose[row], self.networks)
        return self.renderer()(posed, self.camera(camera), geometry)

    def camera(self, camera: Camera) -> Camera:
        """The camera with the pixels that are rendered."""
        return camera if self.size == 1 else camera.scaled(*(max(round(self.size * side), 1) for side in (camera.w, camera.h)))

    def picture(self, run: Run, frame: int, camera: Camera) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the run's background, on all of the camera's pixels. Nothing is left unevaluated."""
        picture = self.image(run, frame, camera).over(run.background)
        if picture.shape[:2] != (camera.h, camera.w):
            picture = resize(picture, (camera.h, camera.w), order=1, mode="edge", anti_aliasing=False).astype(np.float32)
        dr.sync_thread()
        return picture

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self)


#: Samples a ray of a field drawn to convergence: eight times the usual.
CONVERGED_SAMPLES = 1024


def converged(spp: int = 1) -> Setting:
    """What a setting with so many rays a pixel tends to: many samples, and each ray to its end.

    Where in their pixels rays go is part of what is asked for: fields are trained through the centres, and what more rays a pixel are
    worth is told by the truth, not by the field.
    """
    return Setting(CONVERGED_SAMPLES, cutoff=0.0, spp=spp)


def field_digest(run: Run) -> str:
    """SHA-256 (hex) over a field's architecture and parameters and how images are made: equal ones give equal images at equal settings."""
    state = hashlib.sha256(f"{RECIPE} {sorted(run.model.field.preset.to_dict().items())}".encode())
    for name, values in sorted(run.field_tensors().items()):
        state.update(name.encode() + values.tobytes())
    return state.hexdigest()
