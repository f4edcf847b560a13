"""The neural deformable field of a run, as one of the methods compared; `ndf-mi optimise` trains it."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.render.image import RECIPE, ImageRenderer
from ndf_mi.run import Run

METRICS = "metrics.jsonl"


class NeuralField:
    """A run, rendered by quadrature through pixel centres without jitter.

    Args:
        run: the run.
        samples: candidate samples a ray.
    """

    def __init__(self, run: Run, samples: int = 128) -> None:
        self.name = "ndf"
        self._run = run
        self._renderer = ImageRenderer(samples=samples)
        self.history = read_history(run.path)

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the run's background."""
        return self._renderer(self._run.posed(frame), camera).over(self._run.background)

    def facts(self) -> dict[str, Any]:
        """Preset, training options, seconds and steps of training (None where not logged), and samples a ray."""
        config = self._run.config
        trained = config.get("trained", {})
        return {
            "preset": config["preset"],
            "training": config.get("training"),
            "seed": config["seed"],
            "seconds": trained.get("seconds"),
            "steps": trained.get("steps"),
            "samples": self._renderer.samples,
        }

    def fingerprint(self) -> str:
        """SHA-256 (hex) over the field's parameters and how they are rendered: equal ones give equal images."""
        state = hashlib.sha256(f"{RECIPE} {self._run.config['preset']} {self._renderer.samples}".encode())
        for name, values in sorted(self._run.field_tensors().items()):
            state.update(name.encode() + values.tobytes())
        return state.hexdigest()


def read_history(run: Path) -> list[dict[str, float]]:
    """The logged steps of a run, in order; empty if nothing was logged.

    Raises:
        InputError: a line other than the last is not a JSON object. A half-written last line, left by a training that
            was killed, is ignored.
    """
    file = run / METRICS
    if not file.is_file():
        return []
    lines = file.read_text(encoding="utf-8").splitlines()
    entries = []
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if isinstance(entry, dict):
            entries.append(entry)
        elif number < len(lines):
            raise InputError(f"{file}:{number}", repr(line[:40]), "a JSON object a line")
    return entries
