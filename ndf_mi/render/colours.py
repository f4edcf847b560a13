"""What a run's colours are, light or albedo, and a word where they are shown as the other."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import mitsuba as mi

if TYPE_CHECKING:
    from ndf_mi.run import Run

LIT = ("its colours hold the light of its capture, and lights are added to it. Use `ndf_path` or `ndf_quadrature`, or train by "
       "--integrator prbvolpath")
EMITTED = ("its colours are albedos, learnt through scattering, and are shown as if they were light. Use `volpath` and lights, or "
           "`ndf-mi relight`")

_told: set[tuple[str, str]] = set()


def mistaken(run: Run, scattering: bool) -> str | None:
    """What is wrong with showing a run's colours as albedos, where `scattering`, or else as light; None where nothing is, or where the
    run does not say how it was trained."""
    if run.colours == ("light" if scattering else "albedo"):
        return LIT if scattering else EMITTED
    return None


def tell(run: Run, scattering: bool) -> None:
    """Logs a warning where :func:`mistaken` finds something, once a run and process: media are made anew for every picture."""
    text = mistaken(run, scattering)
    if text is None:
        return
    key = (os.path.realpath(run.path), text)
    if key not in _told:
        _told.add(key)
        mi.Log(mi.LogLevel.Warn, f"{run.path}: {text}.")
