"""Wide cloth that hangs from the hips: the skirts of coats, and skirts. A function of the pose, without time.

The cloth hangs from a ring of points at the waist. In each vertical half-plane through the middle of the ring
it follows a profile R(d), the distance from the axis at the depth d below the ring: the soft maximum of its
own flare, and of tents over balls along the legs. So it spreads with the legs, hangs from a raised knee, and
its hem rises there, since lengths along the profile are kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Balls along each leg: joint at the start, at the end, radii there in metres, and their number.
_LIMBS = (
    ("UpLeg", "Leg", 0.105, 0.070, 8),
    ("Leg", "Foot", 0.075, 0.050, 8),
    ("Foot", "ToeBase", 0.05, 0.04, 3),
)
#: Metres of radius that a tent loses per metre above its ball.
_TENT = 1.3
#: Metres over which the soft maximum rounds.
_SOFT = 0.012
#: Depth in metres within which the cloth comes off the ring, and least height above the ground.
_OFF, _GROUND = 0.07, 0.02
_DEPTHS = np.linspace(0, 1.3, 66)


@dataclass(frozen=True)
class Drape:
    """The shape of hanging cloth: a grid of R rows, from the ring down, and C columns around the hips.

    Attributes:
        phi: (C,) angles of the columns, radians: 0 in front, growing to the left. One column is on the left,
            one on the right.
        lengths: (R,) metres along the cloth, from 0 at the ring.
        flare: metres by which the cloth is farther from the axis than the ring, at its own length below it.
        ease: metres between cloth and balls.
        joint_names: (J,).
    """

    phi: np.ndarray
    lengths: np.ndarray
    flare: float
    ease: float
    joint_names: tuple[str, ...]

    def __call__(self, ring: np.ndarray, joints: np.ndarray) -> np.ndarray:
        """(R·C, 3) world vertices, row by row, for the ring, (C, 3), and joints, (J, 3), of a pose."""
        sides = [int(np.abs(np.sin(self.phi) - sign).argmin()) for sign in (1, -1)]
        left = (ring[sides[0]] - ring[sides[1]]) * [1, 0, 1]
        left = left / np.linalg.norm(left)
        out = np.cos(self.phi)[:, None] * np.cross(left, [0, 1, 0]) + np.sin(self.phi)[:, None] * left
        middle = (ring[sides[0]] + ring[sides[1]]) / 2
        start = np.sum((ring - middle) * out, axis=1)

        centres, radii = _balls(joints, self.joint_names)
        towards = (centres - middle) @ out.T
        radii = (radii + self.ease)[:, None, None]
        heights = ring[:, 1, None] - _DEPTHS
        above = np.maximum(heights[None] - centres[:, 1, None, None], 0)
        own = start[:, None] + self.flare * (_DEPTHS / self.lengths[-1]) ** 1.3
        # A tent is a cone that touches its ball, and is vertical below.
        around = np.minimum(radii, radii * np.hypot(1, _TENT) - _TENT * above)
        tents = np.concatenate([own[None], towards[..., None] + around])
        top = tents.max(axis=0)
        soft = top + _SOFT * np.log(np.exp((tents - top) / _SOFT).sum(axis=0))
        profile = own + (soft - own) * (1 - np.exp(-((_DEPTHS / _OFF) ** 2)))

        steps = np.hypot(np.diff(_DEPTHS), np.diff(profile, axis=1))
        walked = np.concatenate([np.zeros((len(ring), 1)), np.cumsum(steps, axis=1)], axis=1)
        columns = zip(walked, profile, strict=True)
        depth, radius = np.stack([(np.interp(self.lengths, way, _DEPTHS), np.interp(self.lengths, way, far))
                                  for way, far in columns], axis=1)
        # Cloth that reaches the ground spreads on it.
        deepest = (ring[:, 1] - _GROUND)[:, None]
        radius = radius + 0.6 * np.maximum(depth - deepest, 0)
        vertices = middle + radius[..., None] * out[:, None]
        vertices[..., 1] = ring[:, 1, None] - np.minimum(depth, deepest)
        return vertices.transpose(1, 0, 2).reshape(-1, 3)


def _balls(joints: np.ndarray, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Centres (M, 3) and radii (M,) in metres of balls along both legs."""
    centres, radii = [], []
    for side in ("Left", "Right"):
        for first, last, thick, thin, count in _LIMBS:
            t = np.linspace(0, 1, count, endpoint=last == "ToeBase")[:, None]
            a, b = (joints[names.index(side + joint)] for joint in (first, last))
            centres.append(a + (b - a) * t)
            radii.append(thick + (thin - thick) * t[:, 0])
    return np.concatenate(centres), np.concatenate(radii)
