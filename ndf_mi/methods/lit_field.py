"""The field of a run as a scattering medium under some light, for relighting."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.learn.loop import expect_capture
from ndf_mi.learn.scattering import SCATTERING
from ndf_mi.learn.scattering_scene import ScatteringScene, expect_outside
from ndf_mi.methods.base import Budget, Light, Progress
from ndf_mi.methods.lit import LitPerformer, LitRenderer
from ndf_mi.run import Run

LAYERS = 4


class RelightableField:
    """A run that was trained through scattering.

    Args:
        grid_spacing: spacing in metres of the grid that the field is shown on, as it was trained: several
            times as fast as the field itself, and blurred by a cell. 0 shows the field itself.
    """

    key, label = "ndf", "NDF"

    def __init__(self, grid_spacing: float = 0.0) -> None:
        self._spacing = grid_spacing

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Raises InputError: `ndf-mi optimise` trains such runs."""
        raise InputError("method ndf", "no run",
                         "a run trained by: ndf-mi optimise CAPTURE -o RUN --integrator prbvolpath")

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads a run.

        Raises:
            InputError: it can't be read, was trained on another capture, or its colours hold the light that
                they were seen in.
        """
        run = Run.load(folder)
        config = run.path / "config.json"
        training = run.config.get("training") or {}
        integrator = training.get("integrator", "ndf_quadrature")
        if integrator not in SCATTERING:
            raise InputError(f"{config}: training.integrator", repr(integrator),
                             f"one of {', '.join(SCATTERING)}: the colours of other runs hold the light that "
                             "they were seen in",
                             "Train one by: ndf-mi optimise CAPTURE -o RUN --integrator prbvolpath")
        if not run.scattered:
            raise InputError(f"{config}: trained.steps", str(run.config["trained"]["steps"]),
                             f"more than the {training['warm_up']} steps by quadrature (warm_up), whose "
                             "colours hold the light that they were seen in",
                             "Continue by: ndf-mi optimise CAPTURE -o RUN --resume. If it has finished, "
                             "train another one with more steps or seconds, or a smaller warm_up.")
        expect_capture(run, capture)
        self._run = run

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Does nothing: the run stays where it is, and `load` takes that folder."""

    def metadata(self) -> dict[str, Any]:
        """Preset, training options, seconds and steps of training, longest path and grid spacing."""
        config = self._run.config
        trained = config.get("trained", {})
        return {"preset": config["preset"], "training": config["training"], "seconds": trained.get("seconds"),
                "steps": trained.get("steps"), "max_depth": int(config["training"]["max_depth"]),
                "grid_spacing": self._spacing}

    def under(self, light: Light, frames: Sequence[int], spp: int) -> LitField:
        """The field in some light, rendered by Mitsuba's `volpath`; arguments as in `Relightable.under`."""
        return LitField(self._run, light, frames, spp, self._spacing, self.metadata())


class LitField(LitPerformer):
    """A run in some light: the field itself in nested shells, or on a grid.

    Args:
        run: trained through scattering.
        light: what lights the scene.
        frames: all frames that will be rendered.
        spp: samples a pixel, an even number.
        spacing: of the grid, metres; 0 for the field itself.
        metadata: of the field.
    """

    key, label = RelightableField.key, RelightableField.label

    def __init__(self, run: Run, light: Light, frames: Sequence[int], spp: int, spacing: float,
                 metadata: dict[str, Any]) -> None:
        super().__init__(run.poses, run.model.band, {**metadata, "spp": spp})
        self._run = run
        self._light = light
        self._spp = spp
        self._spacing = spacing
        self._depth: int = metadata["max_depth"]
        self._grid = ScatteringScene(run, frames, light.emitters, spacing) if spacing else None
        self._frame: int | None = None

    def place(self, camera: Camera, frame: int) -> LitRenderer:
        """The renderer at `frame`. Raises InputError if the camera is inside the performer's band or its
        shell.
        """
        expect_outside(self._run, camera, frame, self._spacing)
        if frame != self._frame:
            integrator = mi.load_dict({"type": "volpath", "max_depth": self._depth, "hide_emitters": True})
            self._renderer = LitRenderer(self._scene(frame), integrator, self._run.background, self._spp)
            self._frame = frame
        return self._renderer

    def cache_key(self) -> str:
        """SHA-256 (hex) over the field's parameters, its surface, the light and how they are rendered."""
        preset = self._run.config["preset"]
        settings = (self._light.name, self._spp, self._depth, LAYERS, self._spacing, preset)
        state = hashlib.sha256(" ".join(map(str, settings)).encode())
        for name, values in sorted(self._run.tensors().items()):
            state.update(name.encode() + values.tobytes())
        return state.hexdigest()

    def _scene(self, frame: int) -> mi.Scene:
        if self._grid is not None:
            with dr.suspend_grad():
                self._grid.place(self._run.posed(frame), frame, np.zeros(3))
            return self._grid.scene
        medium = {"type": "ndf", "run": str(self._run.path), "frame": frame}
        performer = {"type": "ndf_shell", "layers": LAYERS, "interior": medium}
        return mi.load_dict({"type": "scene", **self._light.emitters, "performer": performer})
