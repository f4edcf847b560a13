"""Lights from a Mitsuba scene file, ready to be put into other scenes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ndf_mi.errors import InputError
from ndf_mi.render.scene import load_scene


def lights(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The emitters and shapes of a scene as entries for another scene's dictionary, without its sensors and
    integrator.

    Raises:
        InputError: the scene is missing, cannot be loaded or holds no emitter.
    """
    if not Path(path).is_file():
        raise InputError(path, "no such file", "the Mitsuba scene of a light")
    scene = load_scene(path, {})
    if not scene.emitters():
        raise InputError(path, "a scene without an emitter", "at least one emitter")
    shapes = list(scene.shapes())
    # Shapes bring their own emitters.
    of_shapes = [shape.emitter() for shape in shapes if shape.is_emitter()]
    free = [emitter for emitter in scene.emitters() if not any(emitter is other for other in of_shapes)]
    return {
        **{f"light_{i}": value for i, value in enumerate(free)},
        **{f"around_{i}": value for i, value in enumerate(shapes)},
    }
