"""The folds of the performer's shirt and trousers."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.synthesise.folds import Folds, System
from ndf_mi.capture.synthesise.layers import Frame, waves

#: The two sides as name prefix and sign of x.
SIDES = (("Left", 1), ("Right", -1))


def shirt_folds(frame: Frame, rest: np.ndarray, bottom: float) -> Folds:
    """Folds of a shirt: at elbows and armpits, along twists and bends of the trunk, at the hem."""
    warp = waves(rest, 0.16, 11)
    trunk = 1 - frame.arm
    systems = []
    for side, sign in SIDES:
        own = frame.arm * (frame.left == (sign > 0))
        bend = _bump(frame.arm_s, frame.elbow, 0.075)
        inner = 0.65 + 0.35 * np.cos(frame.arm_phi)
        rings = 2 * np.pi * frame.arm_s / 0.042 + 1.1 * np.sin(frame.arm_phi) + 0.9 * warp
        systems.append(System(rings, 0.011 * own * bend * inner, (f"{side}ForeArm",), None, 0.55, 2.5, 0.1))
        pit = np.array([0.135 * sign, frame.joints["LeftArm"][1] - 0.075, 0.01])
        near = np.linalg.norm(rest - pit, axis=1)
        spokes = 7.0 * np.arctan2(rest[:, 1] - pit[1], np.abs(rest[:, 0]) - np.abs(pit[0])) + 1.4 * warp
        half = 1 / (1 + np.exp(-rest[:, 0] * sign / 0.03))
        fan = half * np.exp(-((near / 0.15) ** 2)) * (1 - np.exp(-((near / 0.04) ** 2)))
        systems.append(System(spokes, 0.012 * fan, (f"{side}Shoulder", f"{side}Arm"), None, 0.6, 1.6, 0.15))
        # A twist pulls diagonal folds, in opposite directions for the two senses.
        turns = 2 * np.pi * (rest[:, 1] / 0.085 + sign * frame.trunk_phi / (2 * np.pi) * 3) + 1.0 * warp
        waist = trunk * _bump(rest[:, 1], 1.06, 0.13)
        spine = ("LowerBack", "Spine", "Spine1")
        systems.append(System(turns, 0.012 * waist, spine, (0, sign, 0), 0.07, 6.0))
        # Bending stacks folds on the shortened side.
        stack = 2 * np.pi * rest[:, 1] / 0.052 + 0.8 * warp
        flank = 0.5 + 0.5 * sign * np.sin(frame.trunk_phi)
        systems.append(System(stack, 0.011 * waist * flank, spine, (0, 0, -sign), 0.08, 5.0))
        # A raised arm lifts the cloth at its side into long slanting folds.
        lifted = trunk * half * _bump(rest[:, 1], 1.08, 0.17)
        pulled = 8 * frame.trunk_phi - sign * 2 * np.pi * rest[:, 1] / 0.22 + 1.2 * warp
        systems.append(System(pulled, 0.011 * lifted, (f"{side}Shoulder", f"{side}Arm"), None, 0.8, 2.4, 0.3))
        # The hem swings with the thigh beneath it.
        hem = trunk * half * _bump(rest[:, 1], bottom, 0.10)
        pleats = 5 * frame.trunk_phi + 0.7 * warp
        systems.append(System(pleats, 0.014 * hem, (f"{side}UpLeg",), None, 0.45, 1.8, 0.35))
    front = trunk * _bump(rest[:, 1], 1.02, 0.11) * (0.5 + 0.5 * np.cos(frame.trunk_phi))
    rolls = 2 * np.pi * rest[:, 1] / 0.06 + 1.2 * warp
    systems.append(System(rolls, 0.013 * front, ("LowerBack", "Spine", "Spine1"), (1, 0, 0), 0.35, 3.0))
    return Folds(systems)


def trouser_folds(frame: Frame, rest: np.ndarray) -> Folds:
    """Folds of trousers: behind and above the knees, from the groin, and the stack above the shoes."""
    warp = waves(rest, 0.18, 12)
    systems = []
    for side, sign in SIDES:
        own = 1 / (1 + np.exp(-rest[:, 0] * sign / 0.012))
        behind = 0.6 - 0.4 * np.cos(frame.leg_phi)
        rings = 2 * np.pi * rest[:, 1] / 0.055 + 1.2 * np.cos(frame.leg_phi) + 1.0 * warp
        knee = own * _bump(rest[:, 1], frame.knee, 0.11) * behind
        systems.append(System(rings, 0.013 * knee, (f"{side}Leg",), None, 0.6, 2.0, 0.12))
        front = 0.5 + 0.5 * np.cos(frame.leg_phi)
        crease = 2 * np.pi * (rest[:, 1] - 0.35 * np.abs(rest[:, 0])) / 0.06 + 1.0 * warp
        groin = own * _bump(rest[:, 1], 0.80, 0.085) * front
        systems.append(System(crease, 0.008 * groin, (f"{side}UpLeg",), (-1, 0, 0), 0.45, 1.8, 0.05))
        seat = own * _bump(rest[:, 1], 0.76, 0.08) * (1 - front)
        systems.append(System(crease, 0.008 * seat, (f"{side}UpLeg",), (1, 0, 0), 0.3, 1.8, 0.1))
        pile = own * _bump(rest[:, 1], 0.17, 0.09)
        stack = 2 * np.pi * rest[:, 1] / 0.05 + 1.5 * np.sin(frame.leg_phi) + 0.9 * warp
        systems.append(System(stack, 0.009 * pile, (f"{side}Leg", f"{side}Foot"), None, 0.7, 2.6, 0.5))
        shin = own * _bump(rest[:, 1], 0.33, 0.13) * (0.6 + 0.4 * np.sin(frame.leg_phi))
        drape = 3 * frame.leg_phi + 2 * np.pi * rest[:, 1] / 0.3 + 0.8 * warp
        systems.append(System(drape, 0.012 * shin, (f"{side}Leg",), None, 0.5, 2.0, 0.25))
    return Folds(systems)


def _bump(values: np.ndarray, centre: float, width: float) -> np.ndarray:
    return np.exp(-(((values - centre) / width) ** 2))
