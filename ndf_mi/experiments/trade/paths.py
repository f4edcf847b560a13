"""A run path traced by Mitsuba's `volpath`: the field itself or on a grid, in one of several bounds."""

from __future__ import annotations

import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.box import BOX_PADDING, padded_box
from ndf_mi.capture.camera import Camera, box_pixels
from ndf_mi.experiments.trade.points import PathSetting
from ndf_mi.methods.lit import LitRenderer
from ndf_mi.methods.lit_field import LAYERS
from ndf_mi.run import Run

CONVERGED_SPP = 512
"""Paths a pixel of pictures that count as converged."""


class PathTracer:
    """Renders a run in some light. It keeps a scene for each frame, kind of bounds and grid.

    Args:
        run: the run.
        lights: entries of a scene's dictionary.
        max_depth: longest path, as Mitsuba counts.
    """

    def __init__(self, run: Run, lights: dict[str, Any], max_depth: int) -> None:
        self._run = run
        self._lights = lights
        self._integrator = mi.load_dict({"type": "volpath", "max_depth": max_depth, "hide_emitters": True})
        self._scenes: dict[tuple[str, float, int], tuple[mi.Scene, float]] = {}

    def picture(self, setting: PathSetting, frame: int, camera: Camera, seed: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the run's background."""
        scene, _ = self._scene(setting, frame)
        low, high = self._box(frame)
        lit = LitRenderer(scene, self._integrator, self._run.background, setting.spp)
        picture, _ = lit.render(camera, box_pixels(camera, low, high), seed)
        dr.sync_thread()
        return picture

    def loading(self, setting: PathSetting, frame: int) -> float:
        """Seconds that the scene took to load; each frame of an animation needs them too."""
        return self._scene(setting, frame)[1]

    def _scene(self, setting: PathSetting, frame: int) -> tuple[mi.Scene, float]:
        key = setting.bounds, setting.grid_spacing, frame
        if key not in self._scenes:
            begun = time.perf_counter()
            performer = self._performer(setting.bounds, setting.grid_spacing, frame)
            scene = mi.load_dict({"type": "scene", **self._lights, "performer": performer})
            self._scenes[key] = scene, time.perf_counter() - begun
        return self._scenes[key]

    def _performer(self, bounds: str, spacing: float, frame: int) -> dict[str, Any]:
        medium = {"type": "ndf", "run": str(self._run.path), "frame": frame, "grid_spacing": spacing}
        if bounds == "box":
            low, high = self._box(frame)
            place = (
                mi.ScalarTransform4f()
                .translate((0.5 * (low + high)).tolist())
                .scale((0.5 * (high - low)).tolist())
            )
            return {"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": medium}
        return {"type": "ndf_shell", "layers": LAYERS if bounds == "nested" else 0, "interior": medium}

    def _box(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        vertices = self._run.poses.vertices[self._run.poses.index(frame)]
        low, high = padded_box(vertices, max(BOX_PADDING, self._run.model.band))
        return np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
