"""Mitsuba plugins of the package: one module a plugin, each with a function ``register()``."""

from __future__ import annotations

import importlib

MODULES: tuple[str, ...] = ("ndf", "ndf_grid", "ndf_path", "ndf_quadrature", "ndf_shell")
"""The modules with a plugin; each module's ``register()`` registers it with the active variant."""


def register() -> None:
    """Registers every plugin for the active variant. A class that derives from one of Mitsuba's belongs to
    the variant that was active when it was defined, so each module defines its class again."""
    for name in MODULES:
        importlib.import_module(f"{__name__}.{name}").register()
