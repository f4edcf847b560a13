"""What a run's colours are, light or albedo, and a warning where they are shown as the other."""

from __future__ import annotations

import os
from functools import cache

import mitsuba as mi

from ndf_mi.run import Run

_TAKEN_FOR_ALBEDO = (
    "its colours hold the light of its capture, and the scene's lights are added to it. Use `ndf_path` or "
    "`ndf_quadrature`, or train with --integrator prbvolpath"
)
_TAKEN_FOR_LIGHT = (
    "its colours are albedos, trained through scattering, and are shown as if they were light. Use "
    "`volpath` and lights, or `ndf-mi relight`"
)


def misread(run: Run, scattering: bool) -> str | None:
    """Why a run's colours should not be shown as albedos, if `scattering`, or as light; None where they can
    be, or where the run does not record how it was trained."""
    if run.colours == ("light" if scattering else "albedo"):
        return _TAKEN_FOR_ALBEDO if scattering else _TAKEN_FOR_LIGHT
    return None


def warn_if_misread(run: Run, scattering: bool) -> None:
    """Logs a warning where :func:`misread` finds a reason, once a run and process."""
    reason = misread(run, scattering)
    if reason is not None:
        _warn(os.path.realpath(run.path), str(run.path), reason)


@cache
def _warn(resolved: str, shown: str, reason: str) -> None:
    mi.Log(mi.LogLevel.Warn, f"{shown}: {reason}.")
