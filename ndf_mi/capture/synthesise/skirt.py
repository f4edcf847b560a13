"""Clothes that hang from the waist to the calves: a wide skirt, and the lower part of an open coat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.capture.synthesise import paint
from ndf_mi.capture.synthesise.drape import Drape
from ndf_mi.capture.synthesise.folds import Folds, System
from ndf_mi.capture.synthesise.grid import grid_faces
from ndf_mi.capture.synthesise.layers import Frame, Layer, Sheet, rise, waves
from ndf_mi.capture.synthesise.wrinkles import SIDES

_COLUMNS, _ROWS = 181, 84
#: Height of the waist at rest, and half the opening of the coat in radians.
_WAIST, _OPEN = 0.985, 0.16
#: Metres from waist to hem along the cloth, metres that the hem is wider, from the body to the waist, and
#: from the legs; a coat leaves room for trousers.
_SKIRT, _SKIRT_FLARE, _SKIRT_WAIST, _SKIRT_EASE = 0.76, 0.26, 0.030, 0.030
_COAT, _COAT_FLARE, _COAT_WAIST, _COAT_EASE = 0.72, 0.21, 0.050, 0.050


def make_skirt(body: Body, naked: Sheet, frame_of: Callable[[Sheet], Frame]) -> Layer:
    """A skirt of the ``body``, whose surface at rest is ``naked``."""
    phi = np.linspace(-np.pi, np.pi, _COLUMNS)[:-1]
    drape, rest, weights = _hung(body, naked, frame_of, phi, _SKIRT, _SKIRT_FLARE, _SKIRT_WAIST, _SKIRT_EASE)
    around, along = np.tile(phi, _ROWS), np.repeat(drape.lengths, len(phi))
    faces = grid_faces(_ROWS, len(phi), capped=False)
    return Layer("skirt", "cloth", faces, rest, weights, paint.skirt(around, along, _SKIRT), clearance=0.012,
                 folds=_folds(around, along / _SKIRT, 11), drape=drape)


def make_coat_tail(body: Body, naked: Sheet, frame_of: Callable[[Sheet], Frame]) -> Layer:
    """The coat below its belt, open in front; arguments as in `make_skirt`."""
    quarter = np.linspace(_OPEN, np.pi / 2, _COLUMNS // 4)
    half = np.concatenate([quarter, np.linspace(np.pi / 2, np.pi, _COLUMNS // 4)[1:]])
    phi = np.concatenate([half, 2 * np.pi - half[-2::-1]])
    drape, rest, weights = _hung(body, naked, frame_of, phi, _COAT, _COAT_FLARE, _COAT_WAIST, _COAT_EASE)
    around, along = np.tile(phi, _ROWS), np.repeat(drape.lengths, len(phi))
    faces = grid_faces(_ROWS, len(phi), closed=False, capped=False)
    rim = np.minimum(around - _OPEN, 2 * np.pi - _OPEN - around)
    colour = paint.coat_tail(around, along, _COAT, rim)
    return Layer("coat tail", "cloth", faces, rest, weights, colour, clearance=0.02,
                 folds=_folds(around, along / _COAT, 8), drape=drape)


def _hung(
    body: Body, naked: Sheet, frame_of: Callable[[Sheet], Frame], phi: np.ndarray, length: float,
    flare: float, waist: float, ease: float,
) -> tuple[Drape, np.ndarray, np.ndarray]:
    """The drape of cloth from ``waist`` metres around the waist, its rest vertices and their weights."""
    assert body.joint_names is not None
    frame = frame_of(naked)
    trunk = naked.rest[(np.abs(frame.y - _WAIST) < 0.03) & (frame.arm < 0.1)]
    around = np.stack([np.sin(phi), 0 * phi, np.cos(phi)], axis=1)
    middle = (trunk.min(axis=0) + trunk.max(axis=0)) / 2 * [0, 0, 1] + [0, _WAIST, 0]
    ring = middle + around * (((trunk - middle) @ around.T).max(axis=0) + waist)[:, None]
    drape = Drape(phi, np.linspace(0, length, _ROWS), flare, ease, tuple(body.joint_names))
    joints = np.stack([frame.joints[name] for name in body.joint_names])
    # The ring is stiff and follows hips and lower back.
    carried = np.zeros(len(body.joint_names))
    carried[[body.joint_names.index(name) for name in ("Hips", "LowerBack")]] = 0.5
    return drape, drape(ring, joints), np.tile(carried, (len(phi) * _ROWS, 1))


def _folds(around: np.ndarray, down: np.ndarray, lobes: int) -> Folds:
    """Flutes that grow towards the hem and travel as legs move, and creases towards a bent leg.

    Args:
        around: (N,) angles around the hips; down: (N,) 0 at the waist, 1 at the hem.
        lobes: number of flutes.
    """
    place = np.stack([np.sin(around), 0.8 * down, np.cos(around)], axis=1)
    warp = waves(place, 1.2, 71)
    low = rise(down, 0.05, 0.9)
    both = ("LeftUpLeg", "RightUpLeg")
    systems = [System(lobes * around + 0.9 * warp, 0.026 * low, both, None, 0.5, 1.2, 0.6),
               System((2 * lobes + 3) * around + 1.3 * warp, 0.008 * low, both, None, 0.6, 2.0, 0.5)]
    middle = np.exp(-(((down - 0.45) / 0.25) ** 2))
    for side, sign in SIDES:
        own = 1 / (1 + np.exp(-sign * np.sin(around) / 0.2))
        front = 0.5 + 0.5 * np.cos(around)
        pulled = 7 * around - sign * 9 * down + 1.2 * warp
        systems.append(System(pulled, 0.016 * own * front * middle, (f"{side}UpLeg",), (-1, 0, 0), 0.45, 1.8))
        behind = own * (1 - front) * rise(down, 0.2, 0.7)
        swung = 6 * around + 8 * down + warp
        systems.append(System(swung, 0.016 * behind, (f"{side}UpLeg", f"{side}Leg"), None, 0.6, 1.6, 0.1))
    twist, high = 8 * around + 12 * down + warp, rise(down, 0.0, 0.3) * (1 - down)
    systems.append(System(twist, 0.010 * high, ("LowerBack", "Spine"), None, 0.2, 3.0))
    return Folds(systems)
