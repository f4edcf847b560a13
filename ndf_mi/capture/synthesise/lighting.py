"""The lights of synthetic captures, soft skies with broad lamps, and the materials of the performer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.files import replacing, write_text

ENVIRONMENT = "lighting.exr"
SCENE = "lighting.xml"
_HEIGHT, _WIDTH = 64, 128

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """An environment, as linear radiance.

    Attributes:
        sky: at the horizon.
        zenith: added towards the zenith.
        ground: below the horizon.
        lamps: for each lamp, its direction, its angular width in radians and the radiance in its middle.
        carried: whether the light turns with the performer's hips, as if the cameras moved around a performer
            in a room.
        flat: whether there is no light, and surfaces show their reflectance in all directions.
    """

    sky: Colour
    zenith: Colour
    ground: Colour
    lamps: tuple[tuple[Colour, float, Colour], ...]
    carried: bool = False
    flat: bool = False

    @property
    def constant(self) -> bool:
        """Whether one scene describes the light in all frames."""
        return not (self.carried or self.flat)


DEFAULT = "studio"
_BLACK = (0.0, 0.0, 0.0)

_STUDIO = Light(
    (0.58, 0.62, 0.68), (0.05, 0.10, 0.20), (0.36, 0.33, 0.29),
    (
        ((0.55, 0.70, 0.60), 0.30, (9.5, 8.8, 7.8)),
        ((-0.75, 0.45, 0.35), 0.50, (1.0, 1.1, 1.35)),
        ((-0.30, 0.40, -0.85), 0.40, (1.9, 1.9, 2.1)),
    ),
)  # fmt: skip

#: By name. In `evening` the key light is orange, low and on the other side, under a dim sky.
LIGHTS = {
    DEFAULT: _STUDIO,
    "carried": replace(_STUDIO, carried=True),
    "flat": Light(_BLACK, _BLACK, _BLACK, (), flat=True),
    "evening": Light(
        (0.13, 0.16, 0.24), (0.02, 0.05, 0.12), (0.07, 0.06, 0.06),
        (
            ((-0.85, 0.30, -0.10), 0.30, (13.0, 7.5, 3.6)),
            ((0.60, 0.25, -0.75), 0.45, (0.5, 0.8, 1.6)),
        ),
    ),
}  # fmt: skip


def light(name: str) -> Light:
    """The light of that name; raises InputError, which lists the existing ones, if there is none."""
    if name not in LIGHTS:
        raise InputError("--light", repr(name), f"one of {', '.join(LIGHTS)}")
    return LIGHTS[name]


def environment(name: str = DEFAULT) -> np.ndarray:
    """(64, 128, 3) float32 linear radiance of a light, in the layout of Mitsuba's ``envmap``, y up."""
    chosen = light(name)
    rows, columns = np.mgrid[0:_HEIGHT, 0:_WIDTH]
    theta = (rows + 0.5) / _HEIGHT * np.pi
    phi = (columns + 0.5) / _WIDTH * 2 * np.pi
    direction = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], axis=-1)
    up = direction[..., 1:2]
    sky = np.array(chosen.sky) + np.array(chosen.zenith) * np.maximum(up, 0)
    ground = np.array(chosen.ground)
    radiance = ground + (sky - ground) / (1 + np.exp(-up / 0.06))
    for towards, width, peak in chosen.lamps:
        axis = np.array(towards) / np.linalg.norm(towards)
        angle = np.arccos(np.clip(direction @ axis, -1, 1))
        radiance = radiance + np.exp(-((angle / width) ** 2))[..., None] * np.array(peak)
    return radiance.astype(np.float32)


def emitter(name: str = DEFAULT) -> dict[str, Any]:
    """A light as a dictionary for a Mitsuba emitter."""
    return {"type": "envmap", "bitmap": mi.Bitmap(environment(name))}


def write(folder: Path, name: str = DEFAULT) -> str:
    """Writes a light into ``folder`` as a Mitsuba scene with its image; returns the scene's name."""
    with replacing(folder / ENVIRONMENT) as temporary:
        mi.Bitmap(environment(name)).write(str(temporary))
    write_text(
        folder / SCENE,
        f'<scene version="3.0.0">\n    <emitter type="envmap">\n'
        f'        <string name="filename" value="{ENVIRONMENT}"/>\n    </emitter>\n</scene>\n',
    )
    return SCENE


#: The colour of a surface by the mesh attribute ``vertex_color``.
COLOUR = {"type": "mesh_attribute", "name": "vertex_color"}


def _glossy(roughness: float, specular: float) -> dict[str, Any]:
    return {"type": "principled", "roughness": roughness, "specular": specular}


#: BSDFs by material, without their colour.
MATERIALS: dict[str, dict[str, Any]] = {
    "cloth": {"type": "diffuse"},
    "leather": _glossy(0.45, 0.5),
    "skin": _glossy(0.5, 0.4),
    "hair": _glossy(0.4, 0.5),
    "eye": _glossy(0.15, 0.5),
    "glossy": _glossy(0.3, 0.8),
}
_CLOSED = ("eye",)


def material(name: str, colour: dict[str, Any] = COLOUR) -> dict[str, Any]:
    """The BSDF of a material in a colour, a dictionary for a Mitsuba texture. Open surfaces have two
    sides."""
    bsdf = MATERIALS[name]
    bsdf = {**bsdf, "reflectance" if bsdf["type"] == "diffuse" else "base_color": colour}
    return bsdf if name in _CLOSED else {"type": "twosided", "bsdf": bsdf}
