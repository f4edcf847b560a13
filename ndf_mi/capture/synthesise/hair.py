"""A chin-length bob with a fringe: strands that follow the head's convex hull, then fall."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from ndf_mi.capture.synthesise import paint
from ndf_mi.capture.synthesise.grid import grid_faces
from ndf_mi.capture.synthesise.layers import Layer, Sheet, rise, waves

_AROUND, _OVER, _DOWN = 144, 36, 22
#: Heights above the eyes in metres: where hair leaves the head, the end of the fringe, the other tips.
_SCALP, _FRINGE, _TIPS = -0.02, 0.034, -0.095
#: The point within the head from which hair grows, from the middle of the eyes, metres.
CROWN = np.array([0, 0.03, -0.085])


def make_hair(naked: Sheet, eyes: np.ndarray, head: int) -> Layer:
    """Hair on the body ``naked``, with eyes at (2, 3) ``eyes``, carried by the joint of index ``head``."""
    middle = eyes.mean(axis=0)
    crown = middle + CROWN

    phi = np.arange(_AROUND) / _AROUND * 2 * np.pi
    elevation = np.pi / 2 * (1 - (np.arange(_OVER) + 0.35) / _OVER)
    phi_grid, up = np.meshgrid(phi, elevation)
    direction = np.stack([np.sin(phi_grid) * np.cos(up), np.sin(up), np.cos(phi_grid) * np.cos(up)], axis=-1)
    over = direction * skull_radius(naked, middle, crown, direction)[..., None]
    fall = np.linspace(0, 1, _DOWN + 1)[1:, None, None] * [0, _TIPS - 0.03 - (crown - middle)[1], 0]
    rest = np.concatenate([over, over[-1] + fall]).reshape(-1, 3) + crown
    sheet = Sheet(rest, np.eye(1), np.zeros((len(rest), 2)), grid_faces(_OVER + _DOWN, _AROUND))

    around = np.tile(phi, _OVER + _DOWN)
    away = np.abs((around + np.pi) % (2 * np.pi) - np.pi)
    height = rest[:, 1] - middle[1]
    locks = waves(np.stack([np.cos(around), np.sin(around), 0 * around], axis=1), 0.35, 61)
    thickness = 0.011 + 0.009 * rise(height, 0.10, -0.06) - 0.004 * rise(np.abs(rest[:, 0]), 0.012, 0.0)
    ripple = 0.0018 * np.sin(31 * around + 1.5 * waves(rest, 0.12, 62)) + 0.0012 * np.sin(67 * around)
    grown = rest + (thickness + ripple + 0.0018 * locks)[:, None] * sheet.normals
    end = _TIPS + (_FRINGE - _TIPS) * rise(away, 1.12, 0.86) + 0.004 * locks
    # The face is below the fringe and in front of the ears.
    sheet = Sheet(grown, np.zeros((len(rest), 1)), sheet.uv, sheet.faces).clipped(height - end)
    weights = np.zeros((len(sheet.rest), naked.weights.shape[1]))
    weights[:, head] = 1
    return Layer("hair", "hair", sheet.faces, sheet.rest, weights, paint.hair(sheet.rest, crown))


def skull_radius(naked: Sheet, eyes: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(…) metres from ``origin``, (3,), in unit ``directions``, (…, 3), to the convex hull of the head of the
    body ``naked`` above the middle of the ``eyes``, (3,)."""
    skull = naked.rest[(naked.rest[:, 1] > eyes[1] + _SCALP) & (np.abs(naked.rest[:, 0]) < 0.15)]
    planes = ConvexHull(skull - origin).equations
    facing = directions @ planes[:, :3].T
    with np.errstate(divide="ignore"):
        return np.where(facing > 1e-6, -planes[:, 3] / facing, np.inf).min(axis=-1)
