"""Colours of cloth, skin, hair and eyes: linear reflectance at rest points, with patterns."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.synthesise.layers import Frame, rise, waves
from ndf_mi.colour import srgb_to_linear


def tone(*srgb: int) -> np.ndarray:
    """Linear reflectance of an 8-bit sRGB colour."""
    return np.asarray(srgb_to_linear(np.array(srgb, dtype=np.float64) / 255))


def over(colour: np.ndarray, paint: np.ndarray, share: np.ndarray) -> np.ndarray:
    """``colour`` (N, 3) blended with ``paint``, (3,) or (N, 3), by the opacity ``share``, (N,) in [0, 1]."""
    return colour + (paint - colour) * share[:, None]


def stripe(turns: np.ndarray, width: float) -> np.ndarray:
    """1 within ``width``, a fraction of the period, around whole numbers of ``turns``; soft edges."""
    distance = np.abs(turns - np.round(turns))
    return rise(distance, width / 2 + 0.04, width / 2 - 0.04)


def shirt(frame: Frame, rest: np.ndarray) -> np.ndarray:
    """A tartan: bands around and along trunk and sleeves, darker cuffs, collar and button strip, buttons."""
    sleeve = rise(frame.arm, 0.42, 0.58)
    around = np.where(sleeve > 0.5, 4 * frame.arm_phi / (2 * np.pi), 11 * frame.trunk_phi / (2 * np.pi))
    along = np.where(sleeve > 0.5, frame.arm_s / 0.09, rest[:, 1] / 0.09)
    colour = np.tile(tone(205, 190, 160), (len(rest), 1))
    for turns in (around, along):
        colour = over(colour, tone(150, 32, 38), 0.62 * stripe(turns, 0.42))
    for turns in (around, along):
        colour = over(colour, tone(26, 38, 70), 0.85 * stripe(turns + 0.5, 0.13))
    colour = over(colour, tone(26, 38, 70), rise(np.abs(sleeve - 0.5), 0.4, 0.1) * 0.7)
    front = (frame.z > 0.02) & (frame.arm < 0.5)
    strip = rise(np.abs(frame.x), 0.022, 0.016) * front
    colour = over(colour, tone(120, 26, 32), strip)
    button = (frame.x**2 + ((rest[:, 1] + 0.02) % 0.085 - 0.0425) ** 2) < 0.0075**2
    return over(colour, tone(240, 235, 225), (button & front).astype(float))


def borders(colour: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """A dark border where ``rim`` (N,), metres from the nearest rim, is below 2 cm."""
    return over(colour, tone(60, 22, 30), rise(rim, 0.022, 0.016))


def trousers(frame: Frame, rest: np.ndarray, hem: float) -> np.ndarray:
    """Denim: pale stripes along the leg, seams, pale knees and thighs, cuffs, a mottled weave."""
    colour = np.tile(tone(52, 72, 112), (len(rest), 1))
    colour = colour * (1 + 0.16 * waves(rest, 0.05, 21))[:, None].clip(0.5, 1.6)
    colour = over(colour, tone(120, 140, 175), 0.5 * stripe(12 * frame.leg_phi / (2 * np.pi), 0.18))
    worn = np.exp(-(((frame.y - frame.knee - 0.02) / 0.09) ** 2)) + np.exp(-(((frame.y - 0.68) / 0.11) ** 2))
    front = 0.5 + 0.5 * np.cos(frame.leg_phi)
    colour = over(colour, tone(150, 168, 195), 0.45 * worn.clip(0, 1) * front**2)
    seam = rise(np.abs(frame.leg_phi - np.pi / 2), 0.12, 0.07)
    colour = over(colour, tone(196, 150, 84), 0.8 * seam * (frame.y < 0.9))
    return over(colour, tone(150, 165, 190), rise(frame.y, hem + 0.05, hem + 0.043))


def shoes(rest: np.ndarray) -> np.ndarray:
    """Dark uppers, a white toe cap and laces, a pale sole below 2 cm."""
    colour = np.tile(tone(44, 92, 84), (len(rest), 1))
    laces = stripe(rest[:, 2] / 0.022, 0.4) * rise(np.abs(np.abs(rest[:, 0]) - 0.19), 0.03, 0.022)
    colour = over(colour, tone(232, 228, 220), laces * (rest[:, 1] > 0.05) * (rest[:, 2] > 0.07))
    colour = over(colour, tone(225, 222, 212), rise(rest[:, 2], 0.195, 0.205))
    return over(colour, tone(228, 224, 214), rise(rest[:, 1], 0.024, 0.018))


def skin(rest: np.ndarray, eyes: np.ndarray, lips: np.ndarray) -> np.ndarray:
    """A face around eyeballs at ``eyes``, (2, 3): mottled skin, flushed cheeks and nose, brows, dark lids,
    and lips of opacity ``lips``, (N,) in [0, 1]."""
    colour = np.tile(tone(206, 152, 122), (len(rest), 1))
    colour = colour * (1 + 0.05 * waves(rest, 0.04, 31) + 0.05 * waves(rest, 0.015, 32))[:, None]
    middle = eyes.mean(axis=0)
    face = rest[:, 2] > middle[2] - 0.05
    nose = np.exp(-(np.linalg.norm(rest - middle - [0, -0.035, 0.05], axis=1) / 0.025) ** 2)
    colour = over(colour, tone(205, 110, 90), 0.4 * nose)
    for eye in eyes:
        side = np.sign(eye[0])
        cheek = np.exp(-(np.linalg.norm(rest - eye - [0.012 * side, -0.045, 0.01], axis=1) / 0.025) ** 2)
        colour = over(colour, tone(208, 98, 82), 0.45 * cheek)
        across = (rest[:, 0] - eye[0]) * side
        arch = 0.021 - 6.0 * (across - 0.006) ** 2
        brow = rise(np.abs(rest[:, 1] - eye[1] - arch), 0.0055, 0.0030)
        brow = brow * rise(np.abs(across - 0.002), 0.026, 0.021)
        colour = over(colour, tone(48, 30, 22), 0.92 * brow * face)
        lid = rise(np.linalg.norm((rest - eye) * [1, 1.6, 0.6], axis=1), 0.026, 0.019)
        colour = over(colour, tone(92, 54, 46), 0.6 * lid * face)
    colour = over(colour, tone(168, 66, 66), 0.85 * lips)
    return colour.clip(0.01, 0.95)


def hair(rest: np.ndarray, crown: np.ndarray) -> np.ndarray:
    """Strands: streaks from the crown, (3,), downwards."""
    around = np.arctan2(rest[:, 0] - crown[0], rest[:, 2] - crown[2])
    wide = 0.5 * np.sin(37 * around + 1.5 * waves(rest, 0.12, 41))
    streak = wide + 0.5 * np.sin(83 * around + 2 * waves(rest, 0.1, 42))
    colour = np.tile(tone(70, 42, 24), (len(rest), 1))
    return over(colour, tone(140, 92, 52), (0.32 + 0.3 * streak).clip(0, 1))


def eye(directions: np.ndarray) -> np.ndarray:
    """White, iris and pupil of an eye that looks along +z, by (N, 3) unit directions."""
    angle = np.arccos(np.clip(directions[:, 2], -1, 1))
    colour = np.tile(tone(235, 230, 225), (len(directions), 1))
    colour = over(colour, tone(70, 100, 90), rise(angle, 0.52, 0.46))
    return over(colour, tone(8, 8, 8), rise(angle, 0.26, 0.20))
