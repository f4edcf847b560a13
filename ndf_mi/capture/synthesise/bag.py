"""A rucksack of 20 cm depth on the back, and where its straps lie on the clothes."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.synthesise import paint
from ndf_mi.capture.synthesise.grid import grid_faces, sphere
from ndf_mi.capture.synthesise.layers import Frame, Layer, rise, waves

_AROUND, _OVER = 180, 120
#: Half of width, height and depth in metres, and the height of the middle at rest.
_HALF = np.array([0.155, 0.225, 0.105])
_MIDDLE = 1.195
#: Exponent of the superellipsoid |x|ⁿ + |y|ⁿ + |z|ⁿ = 1: 2 is an ellipsoid, a large one a box.
_BOX = 5.0
#: Metres from the middle of the chest to the straps, half their width, and the height where they turn aside.
_STRAP, _STRAP_WIDTH, _STRAP_TURN = 0.098, 0.021, 1.20


def make_bag(joint_names: tuple[str, ...], back: float) -> Layer:
    """The bag behind a back at the z coordinate ``back``, metres, carried by the upper spine."""
    directions = sphere(_OVER, _AROUND)[0]
    unit = directions / (np.abs(directions) ** _BOX).sum(axis=1, keepdims=True) ** (1 / _BOX)
    at = unit * _HALF
    behind = rise(-unit[:, 2], 0.2, 0.9)
    pocket = rise(np.abs(at[:, 0]), 0.118, 0.104) * rise(np.abs(at[:, 1] + 0.085), 0.105, 0.09)
    pocket = pocket * behind
    sag = 0.006 * waves(at, 0.2, 91) * behind
    rest = at + [0, _MIDDLE, back - _HALF[2] + 0.015]
    rest[:, 2] -= 0.035 * pocket + sag
    # It leans forward at the top, along the back.
    rest[:, 2] += 0.04 * (unit[:, 1] - 0.2) * (unit[:, 1] > 0.2)
    weights = np.zeros((len(rest), len(joint_names)))
    high = rise(rest[:, 1], 0.98, 1.28)
    weights[:, joint_names.index("Spine1")] = high
    weights[:, joint_names.index("Spine")] = 1 - high
    return Layer("bag", "cloth", grid_faces(_OVER, _AROUND), rest, weights, paint.bag(at, pocket, behind))


def strap_edge(frame: Frame) -> np.ndarray:
    """(N,) metres to the rim of the straps, positive inside: over the shoulders, down the chest, and around
    the sides to the bag."""
    over = np.minimum(_STRAP_WIDTH - np.abs(np.abs(frame.x) - _STRAP), frame.y - _STRAP_TURN + _STRAP_WIDTH)
    around = np.abs(frame.trunk_phi)
    path = _STRAP_TURN - 0.055 * np.maximum(around - 0.75, 0)
    aside = np.minimum(_STRAP_WIDTH - np.abs(frame.y - path), np.abs(frame.x) - _STRAP + _STRAP_WIDTH)
    return np.where(frame.arm < 0.45, np.maximum(over, aside), -0.05)
