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


def curls(direction: np.ndarray) -> np.ndarray:
    """Curly hair with lighter tips, and a bright band around the head, by unit directions (N, 3)."""
    colour = np.tile(tone(52, 30, 20), (len(direction), 1))
    colour = over(colour, tone(150, 84, 44), (0.3 + 0.34 * waves(direction, 0.16, 83)).clip(0, 1))
    colour = over(colour, tone(24, 14, 12), (0.5 * waves(direction, 0.11, 84)).clip(0, 0.8))
    height = direction @ np.array([0, 0.94, -0.34])
    colour = over(colour, tone(216, 168, 40), rise(np.abs(height - 0.42), 0.075, 0.065))
    return over(colour, tone(40, 96, 104), rise(np.abs(height - 0.42), 0.030, 0.022)).clip(0.01, 0.95)


def hat(around: np.ndarray, brim: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Straw in rings with a striped ribbon, by angle, share of the brim's width and metres above the brim."""
    woven = 0.5 + 0.5 * np.sin(60 * around) * np.sin(2 * np.pi * (brim * 9 + height / 0.018))
    colour = over(np.tile(tone(206, 176, 116), (len(around), 1)), tone(142, 106, 58), 0.7 * woven)
    colour = over(colour, tone(122, 62, 40), 0.85 * stripe(3 * brim, 0.2) * (brim > 0.1))
    ribbon = rise(height, 0.058, 0.053) * (brim == 0)
    colour = over(colour, tone(34, 52, 96), ribbon)
    return over(colour, tone(226, 220, 206), ribbon * rise(np.abs(height - 0.030), 0.011, 0.007))


def _wool(across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Herringbone under a window check, by numbers of checks ``across`` and ``along``."""
    zigzag = np.abs((4 * across) % 1 - 0.5) * 1.6
    colour = np.tile(tone(172, 132, 88), (len(across), 1))
    colour = over(colour, tone(112, 80, 54), 0.6 * stripe(3 * along + zigzag, 0.42))
    for turns in (across, along):
        colour = over(colour, tone(44, 56, 60), 0.75 * stripe(turns, 0.12))
        colour = over(colour, tone(178, 74, 48), 0.65 * stripe(turns + 0.5, 0.07))
    return colour


def coat_top(frame: Frame, rest: np.ndarray) -> np.ndarray:
    """Checked wool with lapels, two rows of buttons and dark cuffs."""
    sleeve = frame.arm > 0.5
    across = np.where(sleeve, 4 * frame.arm_phi / (2 * np.pi), 10 * frame.trunk_phi / (2 * np.pi))
    colour = _wool(across, np.where(sleeve, frame.arm_s / 0.1, rest[:, 1] / 0.1))
    front = ((frame.z > 0.02) & ~sleeve).astype(float)
    lapel = rise(np.abs(frame.x) - 0.34 * (frame.y - 1.12), 0.004, -0.004) * (frame.y > 1.12)
    colour = over(colour, tone(58, 42, 36), front * lapel)
    colour = over(colour, tone(30, 24, 22), front * rise(np.abs(frame.x), 0.010, 0.005))
    row = (np.abs(frame.x) - 0.055) ** 2 + ((rest[:, 1] + 0.01) % 0.1 - 0.05) ** 2 < 0.012**2
    return over(colour, tone(222, 190, 120), front * row * (frame.y < 1.16))


def coat_tail(around: np.ndarray, along: np.ndarray, length: float, rim: np.ndarray) -> np.ndarray:
    """The wool below a belt with a buckle line, slanted pockets, and borders at the hem and at the opening,
    ``rim`` radians away."""
    colour = _wool(10 * around / (2 * np.pi), along / 0.1)
    side = np.abs(np.abs((around + np.pi) % (2 * np.pi) - np.pi) - 1.15 + 0.9 * (along - 0.22))
    pocket = rise(side, 0.11, 0.09) * rise(np.abs(along - 0.22), 0.085, 0.078)
    colour = over(colour, tone(70, 50, 42), pocket)
    colour = over(colour, tone(222, 190, 120), pocket * stripe(along / 0.03, 0.25) * rise(side, 0.03, 0.02))
    colour = over(colour, tone(60, 22, 30), rise(length - along, 0.034, 0.026))
    colour = over(colour, tone(60, 22, 30), rise(rim * (0.18 + 0.35 * along), 0.030, 0.022))
    belt = rise(along, 0.085, 0.078)
    colour = over(colour, tone(42, 30, 26), belt)
    stitches = stripe(along / 0.062 - 0.35, 0.1) * stripe(60 * around / (2 * np.pi), 0.5)
    return over(colour, tone(216, 196, 150), belt * stitches)


def skirt(around: np.ndarray, along: np.ndarray, length: float) -> np.ndarray:
    """Panels of two colours with dots, stripes of trim above the hem, and a waistband."""
    panel = rise(np.sin(6 * around), -0.06, 0.06)
    colour = over(np.tile(tone(150, 40, 72), (len(around), 1)), tone(38, 92, 104), panel)
    row = along / 0.062
    column = 36 * around / (2 * np.pi) + 0.5 * (np.floor(row) % 2)
    dots = ((column % 1 - 0.5) / 0.30) ** 2 + ((row % 1 - 0.5) / 0.30) ** 2 < 1
    colour = over(colour, tone(236, 214, 168), 0.85 * (dots & (along < length - 0.17)))
    colour = over(colour, tone(22, 20, 34), 0.8 * stripe(6 * around / np.pi, 0.05))
    hem = length - along
    trims = ((0.15, tone(236, 190, 70)), (0.09, tone(240, 236, 226)), (0.02, tone(24, 22, 40)))
    for height, trim in trims:
        colour = over(colour, trim, rise(np.abs(hem - height), 0.020, 0.014))
    sideways = np.abs((40 * around / (2 * np.pi)) % 1 - 0.5) / 0.4
    diamonds = rise(np.abs(hem - 0.055) / 0.02 + sideways, 1.1, 0.9)
    colour = over(colour, tone(240, 236, 226), diamonds)
    return over(colour, tone(24, 22, 40), rise(along, 0.045, 0.038))


def straps(frame: Frame, edge: np.ndarray) -> np.ndarray:
    """Webbing with stitched borders, ``edge`` metres from the rim, and buckles on the chest."""
    colour = np.tile(tone(38, 40, 44), (len(edge), 1))
    colour = over(colour, tone(232, 150, 50), rise(np.abs(edge - 0.006), 0.004, 0.002))
    return over(colour, tone(200, 204, 210), rise(np.abs(frame.y - 1.25), 0.018, 0.013) * (frame.z > 0))


def bag(at: np.ndarray, pocket: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """Canvas with a flap, a pocket, two leather straps with buckles and piping, by metres from the middle."""
    x, y = at[:, 0], at[:, 1]
    mottled = (1 + 0.10 * waves(at, 0.05, 92))[:, None]
    colour = np.tile(tone(54, 92, 74), (len(at), 1)) * mottled
    flap = rise(y - 0.045 - 0.02 * np.cos(x / 0.05), -0.004, 0.004)
    colour = over(colour, tone(170, 92, 42) * mottled, flap)
    piping = rise(np.abs(y - 0.060 - 0.02 * np.cos(x / 0.05)), 0.006, 0.003)
    colour = over(colour, tone(232, 210, 150), piping)
    checks = stripe(x / 0.034, 0.3) + stripe(y / 0.034, 0.3)
    colour = over(colour, tone(212, 196, 92), 0.55 * checks.clip(0, 1) * pocket)
    colour = over(colour, tone(30, 34, 34), rise(np.abs(pocket - 0.5), 0.42, 0.3) * behind)
    leather = rise(np.abs(np.abs(x) - 0.065), 0.013, 0.010) * behind * (y > -0.06) * (y < 0.19)
    colour = over(colour, tone(62, 36, 24), leather)
    buckle = rise(np.hypot(np.abs(x) - 0.065, y + 0.03), 0.022, 0.017) * behind
    colour = over(colour, tone(214, 208, 190), buckle)
    side = rise(np.abs(x), 0.150, 0.153)
    return over(colour, tone(200, 120, 40), 0.7 * side * stripe(y / 0.05, 0.3))
