"""The plan: what was found in a capture, and the model that follows; a value, on disk as JSON."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.field import Preset
from ndf_mi.json_input import load_json, shown

FORMAT = "ndf-plan"
VERSION = 1


@dataclass(frozen=True)
class Settings:
    """What parts have to be worth, and how much is looked at.

    Attributes:
        accuracy: dB within the mask that the trained model is expected to reach: what a part is worth is told against an error of this.
        worth: dB that a part must be worth of that to be kept.
        frames: training frames looked at, at most, evenly spaced.
        seed: of the places drawn where a capture shows more than are needed.
    """

    accuracy: float = 30.0
    worth: float = 0.1
    frames: int = 24
    seed: int = 0

    def __post_init__(self) -> None:
        for key, low, high in (("accuracy", 5, 80), ("worth", 1e-3, 20), ("frames", 1, 10**6), ("seed", 0, 2**31 - 1)):
            if not low <= getattr(self, key) <= high:
                raise InputError(f"--{key}", repr(getattr(self, key)), f"a number from {low:g} to {high:g}")

    @property
    def floor(self) -> float:
        """The mean squared error in sRGB at `accuracy`."""
        return float(10 ** (-self.accuracy / 10))

    @property
    def allowed(self) -> float:
        """The mean squared error that may be added to it."""
        return float(self.floor * (10 ** (self.worth / 10) - 1))


@dataclass(frozen=True)
class Finding:
    """One question that was put to the capture.

    Attributes:
        key: a word for it.
        question: what was asked.
        evidence: the figures, in a sentence or two.
        follows: what the model has because of them.
        left_out: what it therefore does without; empty where nothing.
        figures: the same figures as numbers; None where they could not be told.
        changes: options of the preset that follow.
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
    """Findings about one capture, and the preset that they add up to.

    Attributes:
        capture: name and digest of the capture.
        looked_at: training cameras and frames that images were read of.
        settings: what parts have to be worth.
        findings: in the order in which they were made.
        preset: the architecture that follows.
    """

    capture: dict[str, str]
    looked_at: dict[str, list[Any]]
    settings: Settings
    findings: tuple[Finding, ...]
    preset: Preset

    def to_dict(self) -> dict[str, Any]:
        """The plan as JSON values."""
        findings = []
        for finding in self.findings:
            values = {name: list(value) if isinstance(value, tuple) else value for name, value in finding.changes.items()}
            findings.append(asdict(finding) | {"changes": values})
        return {"format": FORMAT, "version": VERSION, "capture": self.capture, "looked_at": self.looked_at,
                "settings": asdict(self.settings), "findings": findings, "preset": self.preset.to_dict()}

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes the plan, whole or not at all."""
        files.write_json(path, self.to_dict())


def read_preset(path: Path, digest: str) -> tuple[Preset, dict[str, Any]]:
    """The preset of a plan on disk, and the plan's JSON.

    Raises:
        InputError: there is none, it is no plan, its preset is wrong, or it is of a capture with another digest.
    """
    try:
        value = load_json(path)
    except FileNotFoundError:
        raise InputError(path, "no such file", "`auto`, or a plan made by `ndf-mi plan CAPTURE -o FILE`") from None
    except ValueError as error:
        raise InputError(path, f"something that cannot be read as JSON ({error})", "a plan made by `ndf-mi plan`") from None
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise InputError(f"{path}: format", shown(value.get("format") if isinstance(value, dict) else value), f'"{FORMAT}"')
    if value.get("version") != VERSION:
        raise InputError(f"{path}: version", shown(value.get("version")), str(VERSION), "It was made by another version: plan anew.")
    of = value.get("capture")
    known = of.get("digest") if isinstance(of, dict) else None
    if known != digest:
        raise InputError(f"{path}: capture", f"the digest {str(known)[:12]}", f"{digest[:12]}, that of the capture given",
                         "A plan is made for one capture: plan this one.")
    if not isinstance(value.get("preset"), dict):
        raise InputError(f"{path}: preset", shown(value.get("preset")), "the options of a preset")
    return Preset.from_dict(value["preset"], f"{path}: preset"), value
