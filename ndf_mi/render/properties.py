"""Properties that several of the package's plugins read."""

from __future__ import annotations

import os
from collections.abc import Collection

import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.run import Run


def count(props: mi.Properties, plugin: str, name: str, default: int) -> int:
    """A property that must be a whole number above 0. Raises InputError otherwise."""
    value = int(props.get(name, default))
    if value < 1:
        raise InputError(f"{plugin}: {name}", str(value), "a whole number above 0")
    return value


def aovs(props: mi.Properties, plugin: str, known: Collection[str]) -> list[str]:
    """The names in the property `aovs`, separated by commas. Raises InputError for unknown ones."""
    names = [name.strip() for name in str(props.get("aovs", "")).split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise InputError(f"{plugin}: aovs", repr(name), ", ".join(known))
    return names


def run(props: mi.Properties) -> Run:
    """The run that the property `run` names, as given or relative to the scene's own folder; shared with
    the other plugins of the scene."""
    path = props["run"]
    return Run.shared(path if os.path.isdir(path) else str(mi.file_resolver().resolve(path)))


def frame(run: Run, props: mi.Properties) -> int:
    """The frame that a plugin's properties name, by default the run's first."""
    return int(props.get("frame", int(run.poses.frames[0])))


def offset(run: Run, props: mi.Properties) -> np.ndarray:
    """(3,) float32: how far a plugin's properties have moved the performer, in metres.

    Raises:
        InputError: it is not finite, or the run's networks take world coordinates, in which a moved performer
            would be another.
    """
    moved = np.array(props.get("offset", mi.ScalarVector3f(0.0)), dtype=np.float32).reshape(-1)
    if moved.size != 3 or not np.isfinite(moved).all():
        raise InputError("ndf: offset", str(moved.tolist()), "three finite numbers, in metres")
    if moved.any() and run.model.field.preset.coordinates == "world":
        expected = f"none for {run.path}: its networks take world coordinates"
        raise InputError("ndf: offset", str(moved.tolist()), expected)
    return moved
