"""The plan as a value, and on disk as JSON: what was found in a capture, and the preset that follows."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.json_input import load_json, shown

FORMAT = "ndf-plan"
VERSION = 1


@dataclass(frozen=True)
class PlanSettings:
    """How much a part of the model must be worth, and how many images are read.

    Attributes:
        accuracy: PSNR in dB within the mask that the trained model is expected to reach, against which parts
            are valued.
        worth: dB of that PSNR that a part must be worth to be kept.
        frames: limit on the training frames read; evenly spaced.
        seed: seed for drawing places where a capture shows more than are needed.
        density_limit: largest density in 1/m that the model can have; how deep its band must reach follows.

    Raises:
        InputError: a value is out of range.
    """

    accuracy: float = 30.0
    worth: float = 0.1
    frames: int = 24
    seed: int = 0
    density_limit: float = 500.0

    def __post_init__(self) -> None:
        for key, low, high in (("accuracy", 5, 80), ("worth", 1e-3, 20), ("frames", 1, 10**6),
                               ("seed", 0, 2**31 - 1), ("density_limit", 1, 1e6)):
            if not low <= getattr(self, key) <= high:
                raise InputError(f"--{key}", repr(getattr(self, key)), f"a number from {low:g} to {high:g}")

    @property
    def expected_error(self) -> float:
        """The mean squared error in sRGB at `accuracy`."""
        return float(10 ** (-self.accuracy / 10))

    @property
    def allowed_error(self) -> float:
        """The mean squared error that may be added to it: that of `worth` dB."""
        return float(self.expected_error * (10 ** (self.worth / 10) - 1))


@dataclass(frozen=True)
class Finding:
    """One question about the capture and its answer.

    Attributes:
        key: a word for it.
        question: the question.
        evidence: the figures, in a sentence or two.
        follows: what the model has as a consequence.
        left_out: what the model does without as a consequence; empty if nothing.
        figures: the figures as numbers; None if unknown.
        changes: the preset's options that follow.
    """

    key: str
    question: str
    evidence: str
    follows: str
    left_out: str
    figures: dict[str, float | None]
    changes: dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """Findings about one capture, and the preset that follows from them.

    Attributes:
        capture: name and digest of the capture.
        looked_at: training cameras and frames whose images were read.
        settings: how much a part must be worth.
        findings: in the order of the questions.
        preset: the planned architecture.
        surface: the reference surface that it was made around, `body` or `offset`.
        bands: (V, 2) float32 metres, what the band needs outside and inside at each vertex, at most the
            preset's; None where it was not measured. Not part of the file.
    """

    capture: dict[str, str]
    looked_at: dict[str, list[Any]]
    settings: PlanSettings
    findings: tuple[Finding, ...]
    preset: Preset
    surface: str = "body"
    bands: np.ndarray | None = None

    def to_dict(self) -> dict[str, Any]:
        """The plan as JSON values."""
        findings = []
        for finding in self.findings:
            values = {name: list(value) if isinstance(value, tuple) else value
                      for name, value in finding.changes.items()}
            findings.append(asdict(finding) | {"changes": values})
        return {"format": FORMAT, "version": VERSION, "capture": self.capture, "surface": self.surface,
                "looked_at": self.looked_at, "settings": asdict(self.settings), "findings": findings,
                "preset": self.preset.to_dict()}

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the plan as JSON, atomically."""
        files.write_json(path, self.to_dict())


def read_preset(path: Path, digest: str, surface: str) -> tuple[Preset, dict[str, Any]]:
    """The preset of a plan on disk, and the plan as JSON values.

    Args:
        digest: of the capture to be trained on.
        surface: the reference surface to be trained around, `body` or `offset`.

    Raises:
        InputError: there is no such file, it is no plan, its preset is invalid, or it was made for another
            capture or another surface, whose band may be too narrow or too wide for this one.
    """
    value = load_json(path, "`auto`, or a plan made by `ndf-mi plan CAPTURE -o FILE`")
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        found = value.get("format") if isinstance(value, dict) else value
        raise InputError(f"{path}: format", shown(found), f'"{FORMAT}"')
    if value.get("version") != VERSION:
        raise InputError(f"{path}: version", shown(value.get("version")), str(VERSION),
                         "Another version of ndf-mi made it: run `ndf-mi plan` again.")
    capture = value.get("capture")
    known = capture.get("digest") if isinstance(capture, dict) else None
    if known != digest:
        raise InputError(f"{path}: capture", f"the digest {str(known)[:12]}",
                         f"{digest[:12]}, that of the given capture",
                         "A plan is valid for one capture: run `ndf-mi plan` on this one.")
    # Plans had no choice of surfaces at first.
    around = value.get("surface", "body")
    if around != surface:
        raise InputError(f"{path}: surface", shown(around), f'"{surface}", as in the training',
                         f"Run `ndf-mi plan --surface {surface}`, or train with --option surface={around}.")
    for key, expected in (("preset", "the options of a preset"), ("settings", "those of the plan")):
        if not isinstance(value.get(key), dict):
            raise InputError(f"{path}: {key}", shown(value.get(key)), expected)
    return Preset.from_dict(value["preset"], f"{path}: preset"), value
