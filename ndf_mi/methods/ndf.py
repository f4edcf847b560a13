"""The neural deformable field as a method: a run that `ndf-mi optimise` trained, or one trained here."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi import files
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import preset as preset_of
from ndf_mi.learn.loop import expect_capture
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.refined import refined_camera, seen_by
from ndf_mi.learn.scattering import SCATTERING
from ndf_mi.learn.trained import clear, expect_options, trained
from ndf_mi.methods.base import Budget, Progress
from ndf_mi.render.image import RECIPE, ImageRenderer
from ndf_mi.run import SURFACE, Run
from ndf_mi.training_log import FILE_NAME as LOG
from ndf_mi.training_log import read_training_log

HISTORY = ("step", "seconds", "loss")
"""Keys of a logged step that the training curve takes."""

HELD_BACK = ("step", "seconds", "held_back_psnr")
"""Keys that the curve of held-back views takes."""

FILES = ("body.npz", "poses.npz", "field.safetensors", SURFACE, LOG)
"""What a run holds besides `config.json` and the state of its training."""

UNLIMITED = 10**9
"""Steps of a training that its seconds limit."""


class NeuralField:
    """A field rendered by quadrature, one ray through each pixel's centre, without jitter.

    Its folder is that of a run. A run that was trained through scattering cannot be loaded: its colours are
    an albedo.

    Args:
        samples: candidate samples a ray.
        preset: the architecture that `fit` trains; by default, the one planned for the capture.

    Attributes:
        run: what is rendered, once trained or loaded.
    """

    key, label = "ndf", "NDF"

    def __init__(self, samples: int = 128, preset: str | None = None) -> None:
        self._renderer = ImageRenderer(samples=samples)
        self._preset = None if preset is None else preset_of(preset)

    @classmethod
    def of(cls, run: Run, samples: int = 128) -> NeuralField:
        """The method for a run in memory, which must have been trained by quadrature."""
        method = cls(samples)
        method._take(run)
        return method

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Trains a run in a temporary folder; otherwise as `fit_in`."""
        self._scratch = tempfile.TemporaryDirectory(prefix="ndf-mi-")
        self.fit_in(Path(self._scratch.name) / "run", capture, budget, progress)

    def fit_in(self, folder: str | os.PathLike[str], capture: Capture, budget: Budget,
               progress: Progress | None = None) -> None:
        """Trains a run by the default schedule, which is as long as the budget; without seconds, it has the
        default number of steps. A stopped training in the folder continues if its options are the same.

        Raises:
            KeyboardInterrupt: stopped by a signal; the next call continues.
        """
        options = TrainingOptions(seed=budget.seed)
        if budget.seconds is not None:
            options = replace(options, seconds=budget.seconds, steps=UNLIMITED)
        folder = Path(folder)
        try:
            expect_options(Run.load(folder), capture, self._preset, options)
        except InputError:
            # There is no run, a damaged one, or that of another training.
            clear(folder)
        self._take(trained(folder, capture, self._preset, options, quiet=progress is not None,
                           progress=progress))

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads a run.

        Raises:
            InputError: the run can't be read, was trained on another capture, or was trained through
                scattering.
        """
        run = Run.load(folder)
        expect_capture(run, capture)
        integrator = (run.config.get("training") or {}).get("integrator")
        if integrator in SCATTERING:
            raise InputError(f"{run.path / 'config.json'}: training.integrator", repr(integrator),
                             "a run trained by ndf_quadrature",
                             "The colours of this run are an albedo: show it by `ndf-mi relight`.")
        self._take(run)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Copies the run, without what only further training needs."""
        for name in FILES:
            file = self.run.path / name
            if file.is_file():
                with files.replacing(Path(folder) / file.name) as temporary:
                    shutil.copyfile(file, temporary)
        # Last, as a run without it counts as unfinished.
        files.write_json(Path(folder) / "config.json", self.run.config)

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the run's background. A training camera of the capture has
        its correction and its map of colour, if these were trained."""
        image = self._renderer(self.run.posed(frame), refined_camera(self.run, camera))
        image.linear = seen_by(self.run, camera, image.linear, image.opacity)
        return image.over(self.run.background)

    def metadata(self) -> dict[str, Any]:
        """The optional keys of `methods.base`, and `preset`, `training` (all options of both), and `samples`
        a ray.
        """
        config = self.run.config
        trained = config.get("trained", {})
        return {
            "preset": config["preset"],
            "training": config.get("training"),
            "capture": (config.get("capture") or {}).get("digest"),
            "seed": config["seed"],
            "seconds": trained.get("seconds"),
            "steps": trained.get("steps"),
            "samples": self._renderer.samples,
            "options": {"samples": self._renderer.samples},
            "history": self._curve(HISTORY),
            "held_back": self._curve(HELD_BACK),
            "kept_step": (trained.get("kept") or {}).get("step"),
        }

    def cache_key(self) -> str:
        """SHA-256 (hex) over the field's parameters, its surface, and how they are rendered."""
        state = hashlib.sha256(f"{RECIPE} {self.run.config['preset']} {self._renderer.samples}".encode())
        for name, values in sorted(self.run.tensors().items()):
            state.update(name.encode() + values.tobytes())
        return state.hexdigest()

    def _curve(self, keys: tuple[str, ...]) -> list[list[float]]:
        """These values of the logged steps that have them all."""
        return [[row[key] for key in keys] for row in self._history if row.keys() >= set(keys)]

    def _take(self, run: Run) -> None:
        self.run = run
        self._history = read_training_log(run.path)
