"""Gaussians on the body as a method."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import msgspec
import numpy as np

from ndf_mi.capture.agreement import check_agreement
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.learn.prepare import LONGEST, SHARE
from ndf_mi.learn.state import write_state
from ndf_mi.methods.base import Budget, Progress
from ndf_mi.methods.gaussians.compositing import Posed
from ndf_mi.methods.gaussians.hits import Rectangle
from ndf_mi.methods.gaussians.primitives import LEARNED, LIGHT, Binding
from ndf_mi.methods.gaussians.training import (
    NETWORK,
    SHADE,
    Settings,
    SplatOptimisation,
    Splats,
    ViewObjective,
    see,
)
from ndf_mi.methods.volume.method import STATE, RecordedMethod
from ndf_mi.methods.volume.record import (
    FILE_NAME,
    TENSORS,
    Tensors,
    VolumeRecord,
    expect_shape,
    read_checkpoint,
    read_volume,
)
from ndf_mi.methods.volume.stages import train
from ndf_mi.surface.reference import fit_reference, with_offsets
from ndf_mi.surface.rest_frames import RestFrames

RECIPE = 1
"""Version of the renderer; it rises whenever the same primitives give a different image."""

FIXED = "offsets", "triangle", "barycentric"
"""What is saved besides what is learned, by name; `offsets` only where there are some."""


class Gaussians(RecordedMethod):
    """Anisotropic Gaussian primitives bound to the triangles of the body with offsets, one ray through each
    pixel's centre. They are composited in sRGB, as in 3D Gaussian splatting.

    Its folder holds `volume.json` and `volume.safetensors`.

    Args:
        settings: how primitives are made and trained; `load` replaces them by those of the folder.
    """

    key, label = "gaussians", "Gaussians on the body"

    def __init__(self, settings: Settings = Settings()) -> None:  # noqa: B008 (immutable)
        self.settings = settings

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads what `save` wrote.

        Raises:
            InputError: a file is missing or damaged, or does not belong to the method or the capture.
        """
        record, tensors = read_volume(folder, self.key, capture)
        try:
            self.settings = msgspec.convert(record.preset, Settings)
        except msgspec.ValidationError as error:
            raise InputError(f"{Path(folder) / FILE_NAME}: preset", str(error), "options of this version",
                             "Train it again.") from None
        where = f"{Path(folder) / TENSORS}: "
        triangle = tensors.get("triangle")
        count = 0 if triangle is None else triangle.size
        if triangle is None or triangle.dtype != np.int32 or not count or triangle.ndim != 1 \
                or triangle.min() < 0 or triangle.max() >= len(capture.body.faces):
            raise InputError(f"{where}triangle", "nothing" if triangle is None else "other numbers",
                             "int32 indices of the body's triangles, at least one")
        for name, shape in {"barycentric": (count, 3), **{n: (k, count) for n, k in LEARNED.items()}}.items():
            expect_shape(where + name, tensors.get(name), shape)
        weights = Splats.for_capture(capture, self.settings).network.initial(np.random.default_rng(0))
        expect_shape(where + NETWORK, tensors.get(NETWORK), weights.shape)
        expect_shape(where + SHADE, tensors.get(SHADE), (LIGHT,))
        self._take(capture, record, tensors)

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background."""
        with dr.suspend_grad():
            colour, opacity, _ = see(self.posed(frame), Rectangle(camera, 0, 0, camera.w, camera.h))
            image = colour + (1.0 - opacity) * mi.Color3f(self._background.tolist())
            return np.clip(np.array(image, np.float32).T, 0, 1).reshape(camera.h, camera.w, 3)

    def posed(self, frame: int) -> Posed:
        """The primitives at a frame, for `scene.ellipsoids`. Raises InputError if there is no such
        frame."""
        return self._splats.at(self._binding, self._parameters, frame)

    def training_settings(self) -> dict[str, Any]:
        """As `methods.base.Configured`."""
        found: dict[str, Any] = msgspec.to_builtins(self.settings)
        return found

    def metadata(self) -> dict[str, Any]:
        """The members of the record, and keys that `methods.base` lists."""
        known = msgspec.to_builtins(self._record)
        count, surface = len(self._binding), self.settings.surface
        where = "the body with offsets" if surface == "offset" else "the body"
        settings, more = known.pop("preset"), known.pop("more")
        return {**known, **more, "settings": settings, "primitives": count,
                "options": {}, "note": f"{count:,} primitives on {where}."}

    def cache_key(self) -> str:
        """SHA-256 (hex) over primitives, surface, capture and how they are rendered."""
        how = [RECIPE, self._record.preset, self._record.capture]
        state = hashlib.sha256(json.dumps(how).encode())
        for name, values in sorted(self._tensors.items()):
            state.update(name.encode() + values.tobytes())
        return state.hexdigest()

    def _train(self, folder: Path | None, capture: Capture, budget: Budget,
               progress: Progress | None) -> None:
        record, settings = self._record_of(capture, budget), self.settings
        state = None if folder is None else read_checkpoint(folder / STATE, record)
        if state is None:
            started = time.perf_counter()
            check_agreement(capture)
            fixed = {}
            if settings.surface == "offset":
                longest = None if budget.seconds is None else min(SHARE * budget.seconds, LONGEST)
                fixed["offsets"] = fit_reference(capture, longest, budget.seed).offsets
            record.surface_seconds = time.perf_counter() - started
        else:
            record.surface_seconds = float(state[1]["surface_seconds"])
            fixed = {name: state[0][name] for name in FIXED if name in state[0]}
        placed = on_surface(capture, fixed)
        splats = Splats.for_capture(placed, settings)
        if state is None:
            binding = splats.spread(np.random.default_rng([budget.seed, 0]))
        else:
            binding = Binding(fixed["triangle"], fixed["barycentric"])
        objective = ViewObjective(placed, splats, binding, settings)
        optimisation = SplatOptimisation(objective, settings, budget.seconds, budget.seed,
                                         record.surface_seconds)
        if state is not None:
            optimisation.restore(*state, str(folder))

        def known() -> Tensors:
            bound = optimisation.binding
            return {**fixed, "triangle": bound.triangle, "barycentric": bound.barycentric}

        def checkpoint() -> None:
            if folder is not None:
                write_state(folder / STATE, {**known(), **optimisation.tensors()},
                            {**optimisation.metadata(), "surface_seconds": record.surface_seconds,
                             "record": msgspec.to_builtins(self._record_of(capture, budget))})

        train(optimisation, progress, checkpoint)
        record.seconds, record.steps = round(optimisation.seconds, 3), optimisation.steps
        record.refused, record.history = optimisation.steps_refused, optimisation.history
        self._take(capture, record, {**known(), **optimisation.learned,
                                     **{name: optimisation.parameters[name].numpy()
                                        for name in (NETWORK, SHADE)}})

    def _record_of(self, capture: Capture, budget: Budget) -> VolumeRecord:
        """The record of a training that has not begun."""
        preset = json.loads(json.dumps(dataclasses.asdict(self.settings)))
        return VolumeRecord(method=self.key, preset=preset, capture=capture.digest, seed=budget.seed,
                            budget=budget.seconds)

    def _take(self, capture: Capture, record: VolumeRecord, tensors: Tensors) -> None:
        self._background = capture.background
        self._splats = Splats.for_capture(on_surface(capture, tensors), self.settings)
        self._binding = Binding(tensors["triangle"], tensors["barycentric"])
        self._parameters = {name: mi.Float(tensors[name].ravel()) for name in (*LEARNED, NETWORK, SHADE)}
        self._record, self._tensors = record, tensors


def on_surface(capture: Capture, tensors: Tensors) -> Capture:
    """The capture with the surface that primitives are bound to as its body."""
    if "offsets" not in tensors:
        return capture
    return capture.with_body(*with_offsets(capture, RestFrames(capture), tensors["offsets"]))
