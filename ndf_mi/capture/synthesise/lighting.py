"""The studio's light and the materials that it falls on: a soft sky with a broad key light and a dimmer one behind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ndf_mi.files import replacing, write_text

ENVIRONMENT = "lighting.exr"
SCENE = "lighting.xml"
_HEIGHT, _WIDTH = 64, 128

#: Direction towards the light, angular width (radians), linear radiance at its middle.
_LOBES = (
    ((0.55, 0.70, 0.60), 0.30, (9.5, 8.8, 7.8)),
    ((-0.75, 0.45, 0.35), 0.50, (1.0, 1.1, 1.35)),
    ((-0.30, 0.40, -0.85), 0.40, (1.9, 1.9, 2.1)),
)


def environment() -> np.ndarray:
    """(64, 128, 3) float32 linear radiance, in the layout of Mitsuba's ``envmap``, y up."""
    rows, columns = np.mgrid[0:_HEIGHT, 0:_WIDTH]
    theta = (rows + 0.5) / _HEIGHT * np.pi
    phi = (columns + 0.5) / _WIDTH * 2 * np.pi
    direction = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], axis=-1)
    up = direction[..., 1:2]
    sky = np.array([0.58, 0.62, 0.68]) + np.array([0.05, 0.10, 0.20]) * np.maximum(up, 0)
    ground = np.array([0.36, 0.33, 0.29])
    radiance = ground + (sky - ground) / (1 + np.exp(-up / 0.06))
    for towards, width, peak in _LOBES:
        axis = np.array(towards) / np.linalg.norm(towards)
        angle = np.arccos(np.clip(direction @ axis, -1, 1))
        radiance = radiance + np.exp(-((angle / width) ** 2))[..., None] * np.array(peak)
    return radiance.astype(np.float32)


def emitter() -> dict[str, Any]:
    """The light as the dictionary of a Mitsuba emitter."""
    return {"type": "envmap", "bitmap": mi.Bitmap(environment())}


def write(folder: Path) -> str:
    """Writes the light as a Mitsuba scene with its image into ``folder``; returns the scene's file name."""
    with replacing(folder / ENVIRONMENT) as beside:
        mi.Bitmap(environment()).write(str(beside))
    write_text(
        folder / SCENE,
        f'<scene version="3.0.0">\n    <emitter type="envmap">\n'
        f'        <string name="filename" value="{ENVIRONMENT}"/>\n    </emitter>\n</scene>\n',
    )
    return SCENE


def _glossy(roughness: float, specular: float, twosided: bool) -> dict[str, Any]:
    bsdf = {
        "type": "principled",
        "base_color": {"type": "mesh_attribute", "name": "vertex_color"},
        "roughness": roughness,
        "specular": specular,
    }
    return {"type": "twosided", "bsdf": bsdf} if twosided else bsdf


#: BSDFs by material; each takes its colour from the mesh attribute ``vertex_color``. Open surfaces are seen from inside too.
MATERIALS: dict[str, dict[str, Any]] = {
    "cloth": {
        "type": "twosided",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}},
    },
    "leather": _glossy(0.45, 0.5, twosided=True),
    "skin": _glossy(0.5, 0.4, twosided=True),
    "hair": _glossy(0.4, 0.5, twosided=True),
    "eye": _glossy(0.15, 0.5, twosided=False),
}
