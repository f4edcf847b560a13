"""The field of a run as a scattering medium under some light."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.box import BOX_PADDING, padded_box
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.pixels import box_pixels
from ndf_mi.learn.scattering_scene import ScatteringScene, expect_outside
from ndf_mi.methods.lit import Lit
from ndf_mi.run import Run

LAYERS = 4


class LitField:
    """A run by Mitsuba's `volpath`: the field itself, in nested shells, or on a lattice as it was trained, which is several times as fast.

    Args:
        run: the run.
        lights: entries of a scene's dictionary.
        label: of the light, for the fingerprint.
        spp: samples a pixel.
        max_depth: longest path.
        frames: the frames that there will be.
        lattice: the lattice's spacing in metres; 0 for the field itself.

    Attributes:
        noise: of the images rendered, the share of their mean squared error that is noise, one number an image.
    """

    def __init__(self, run: Run, lights: dict[str, Any], label: str, spp: int, max_depth: int, frames: Sequence[int],
                 lattice: float = 0.0) -> None:
        self.name = "ndf"
        self.noise: list[float] = []
        self._run = run
        self._lights = lights
        self._label = label
        self._spp = spp
        self._depth = max_depth
        self._lattice = lattice
        self._stage = ScatteringScene(run, frames, lights, lattice) if lattice else None
        self._frame: int | None = None

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the run's background.

        Raises:
            InputError: the camera is inside the performer's band or its shell.
        """
        expect_outside(self._run, camera, frame, self._lattice)
        if frame != self._frame:
            self._lit = Lit(self._scene(frame), self._integrator(), self._run.background, self._spp)
            self._frame = frame
        vertices = self._run.poses.vertices[self._run.poses.index(frame)]
        low, high = padded_box(vertices, max(BOX_PADDING, self._run.model.band))
        image, noise = self._lit.render(camera, box_pixels(camera, low, high), frame)
        self.noise.append(noise)
        return image

    def _scene(self, frame: int) -> mi.Scene:
        if self._stage is not None:
            with dr.suspend_grad():
                self._stage.place(self._run.posed(frame), frame, np.zeros(3))
            return self._stage.scene
        medium = {"type": "ndf", "run": str(self._run.path), "frame": frame}
        return mi.load_dict({"type": "scene", **self._lights, "performer": {"type": "ndf_shell", "layers": LAYERS, "interior": medium}})

    def _integrator(self) -> Any:
        return mi.load_dict({"type": "volpath", "max_depth": self._depth, "hide_emitters": True})

    def facts(self) -> dict[str, Any]:
        """Preset, training options, seconds and steps of training, samples a pixel and the longest path."""
        config = self._run.config
        trained = config.get("trained", {})
        return {"preset": config["preset"], "training": config.get("training"), "seconds": trained.get("seconds"),
                "steps": trained.get("steps"), "spp": self._spp, "max_depth": self._depth, "lattice": self._lattice}

    def fingerprint(self) -> str:
        """SHA-256 (hex) over the field's parameters, the light and how they are rendered: equal ones give equal images."""
        state = hashlib.sha256(f"{self._label} {self._spp} {self._depth} {LAYERS} {self._lattice} {self._run.config['preset']}".encode())
        for name, values in sorted(self._run.field_tensors().items()):
            state.update(name.encode() + values.tobytes())
        return state.hexdigest()
