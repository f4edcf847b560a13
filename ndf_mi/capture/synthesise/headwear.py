"""What stands far off the head: big curly hair, and a hat with a wide brim."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.synthesise import paint
from ndf_mi.capture.synthesise.grid import grid_faces, sphere
from ndf_mi.capture.synthesise.hair import CROWN, skull_radius
from ndf_mi.capture.synthesise.layers import Layer, Sheet, rise, waves

_AROUND, _OVER = 180, 120
#: Metres of hair on the head, and its depth within the head below the hairline.
_THICK, _SUNK = 0.165, 0.03
#: The brim: metres above the eyes, width, and height of the hat above it.
_BRIM, _BRIM_WIDTH, _TALL = 0.058, 0.17, 0.135


def make_big_hair(naked: Sheet, eyes: np.ndarray, head: int) -> Layer:
    """Curls around the head of ``naked``, with eyes at (2, 3), carried by the joint of index ``head``."""
    middle = eyes.mean(axis=0)
    crown = middle + CROWN
    direction, phi, up = sphere(_OVER, _AROUND)
    # From the hairline above the forehead, past the ears, to the neck.
    hairline = np.radians(-50 + 77 * (0.5 + 0.5 * np.cos(phi)) ** 2.2)
    grown = rise(up - hairline, 0.0, np.radians(20))
    curls = 0.010 * waves(direction, 0.45, 81) + 0.007 * waves(direction, 0.16, 82)
    thick = -_SUNK + (_THICK + _SUNK + curls) * grown
    radius = skull_radius(naked, middle, crown, direction) + thick
    rest = crown + direction * radius[:, None]
    faces = grid_faces(_OVER, _AROUND)
    return _carried("hair", "cloth", rest, faces, paint.curls(direction), naked, head)


def make_hat(naked: Sheet, eyes: np.ndarray, head: int) -> Layer:
    """A felt hat over a bob; arguments as in `make_big_hair`."""
    middle = eyes.mean(axis=0)
    base = middle + CROWN * [1, 0, 1] + [0, _BRIM, 0]
    phi = np.arange(_AROUND) / _AROUND * 2 * np.pi
    around = np.stack([np.sin(phi), 0 * phi, np.cos(phi)], axis=1)
    inner = skull_radius(naked, middle, base, around) + 0.024
    # From the top's middle to its edge, down the side, along the brim: share of the radius, height, width.
    t = np.linspace(0, 1, 24)[:, None]
    edge = np.pi / 2 * np.linspace(0, 1, 10)[1:, None]
    lid = np.stack([0.03 + 0.75 * t, np.full_like(t, _TALL), 0 * t])
    bend = np.stack([0.78 + 0.10 * np.sin(edge), _TALL - 0.02 + 0.02 * np.cos(edge), 0 * edge])
    side = np.stack([0.88 + 0.12 * t[1:], (_TALL - 0.02) * (1 - t[1:]), 0 * t[1:]])
    brim = np.stack([np.ones_like(t[1:]), 0 * t[1:], _BRIM_WIDTH * t[1:]])
    share, height, width = np.concatenate([lid, bend, side, brim], axis=1)
    radius = inner * share + width
    out = width / _BRIM_WIDTH
    height = height - 0.025 * out + out**2 * (0.012 - 0.030 * np.cos(2 * phi)) - 0.008 * np.cos(phi) * out
    # The top is creased from front to back.
    pinch = 0.035 * np.exp(-((radius * np.sin(phi) / 0.035) ** 2)) * rise(share, 0.95, 0.6) * (width == 0)
    rest = base + radius[..., None] * around + (height - pinch)[..., None] * [0, 1, 0]
    rows = rest.reshape(-1, 3)
    # It sits a little towards the neck.
    lean = np.array([[1, 0, 0], [0, np.cos(0.12), np.sin(0.12)], [0, -np.sin(0.12), np.cos(0.12)]])
    placed = base + (rows - base) @ lean.T
    colour = paint.hat(np.tile(phi, len(share)), np.repeat(out.ravel(), _AROUND), (rows - base)[:, 1])
    return _carried("hat", "cloth", placed, grid_faces(len(share), _AROUND), colour, naked, head)


def _carried(
    name: str, material: str, rest: np.ndarray, faces: np.ndarray, colour: np.ndarray, naked: Sheet,
    joint: int,
) -> Layer:
    """A layer that the joint of index ``joint`` carries."""
    weights = np.zeros((len(rest), naked.weights.shape[1]))
    weights[:, joint] = 1
    return Layer(name, material, faces, rest, weights, colour)
