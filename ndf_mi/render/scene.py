"""Loads scenes, renders them and takes their lights; Mitsuba's exceptions become InputErrors."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ndf_mi.colour import linear_to_srgb
from ndf_mi.errors import InputError


def load_scene(path: str | os.PathLike[str], parameters: dict[str, str]) -> mi.Scene:
    """Loads a scene with values for its ``$`` parameters.

    Raises:
        InputError: Mitsuba or a plugin refuses it; the message says why.
    """
    try:
        scene = mi.load_file(str(path), **parameters)
    except (RuntimeError, ValueError, TypeError) as error:
        found = f"a scene that cannot be loaded: {_plainly(error)}"
        raise InputError(path, found, "a scene that Mitsuba loads") from None
    if not isinstance(scene, mi.Scene):
        raise InputError(path, f"a {type(scene).__name__}", "a scene")
    return scene


def lights(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The emitters and shapes of a scene's file as entries for another scene's dictionary, without its
    sensors and integrator.

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
    return {f"light_{i}": value for i, value in enumerate(free)} | {
        f"around_{i}": value for i, value in enumerate(shapes)}


def render_scene(
    scene: mi.Scene, sensor: int = 0, spp: int = 0, size: tuple[int, int] | None = None, seed: int = 0
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Renders a scene with its own integrator.

    Args:
        spp: samples a pixel; 0 for the sampler's own.
        size: width and height in pixels, or the film's own.

    Raises:
        InputError: there is no such sensor, the integrator cannot render the scene, or pixels are not finite.

    Returns:
        all channels by name, each (h, w) float32, and the radiance as (h, w, 3) sRGB clipped to [0, 1].
    """
    sensors = scene.sensors()
    if sensor >= len(sensors):
        raise InputError("sensor", str(sensor), f"0 to {len(sensors) - 1}, as many as the scene has")
    if size is not None:
        params = mi.traverse(sensors[sensor])
        params["film.size"] = mi.ScalarVector2u(*size)
        params["film.crop_size"] = mi.ScalarVector2u(*size)
        params.update()
    try:
        mi.render(scene, sensor=sensors[sensor], spp=spp, seed=seed)
    except (RuntimeError, TypeError, ValueError) as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, InputError):
                raise cause from None
            cause = cause.__cause__
        found = f"one that its integrator cannot render: {_plainly(error)}"
        raise InputError("scene", found, "another integrator or scene") from None
    bitmap = sensors[sensor].film().bitmap(raw=False)
    array = np.array(bitmap, dtype=np.float32)
    broken = np.count_nonzero(~np.isfinite(array).all(-1))
    if broken:
        raise InputError("scene", f"NaN or infinity in {broken} pixels", "a finite picture",
                         "A performer gives them where networks run in half precision, as on GPUs, and "
                         "hidden values exceed 65,504.")
    channels = {field.name: array[..., i] for i, field in enumerate(bitmap.struct_())}
    colour = np.stack([channels[name] for name in "RGB"], -1) if "R" in channels else array[..., [0, 0, 0]]
    return channels, np.clip(linear_to_srgb(np.maximum(colour, 0)), 0, 1)


def _plainly(error: BaseException) -> str:
    """The message of a Mitsuba exception without Python frames; the plugin's own message if there is one."""
    text = str(error)
    own = text.rpartition("InputError: ")[2] if "InputError: " in text else text
    lines = (line.strip() for line in own.splitlines())
    frames = ("File ", "Traceback", "At:", "^")
    return " ".join(line for line in lines if line and not line.startswith(frames))
