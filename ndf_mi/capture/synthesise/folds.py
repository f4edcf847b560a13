"""Folds of cloth: fixed displacement fields with amplitudes and phases that follow the joints.

The displacement along the normal is F·c(θ): F (N, K) is made once from rest coordinates, and c(θ) (K,) is a
smooth function of the pose. Each fold system is a pair of fields, A·sin(φ + δ) = A cos δ·sin φ + A sin δ·cos
φ: bending a joint raises folds (A) and makes them travel (δ).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix


@dataclass(frozen=True)
class System:
    """A fold system.

    Attributes:
        phase: (N,) radians.
        envelope: (N,) metres.
        joints: the joints that drive it, whose axis-angle vectors are summed to v.
        axis: None to use |v|², which is smooth at rest; or (3,) to use the square of the positive part of
            v·axis.
        onset: angle in radians at half the amplitude.
        travel: phase shift per radian.
        base: fraction of the amplitude at rest.
    """

    phase: np.ndarray
    envelope: np.ndarray
    joints: tuple[str, ...]
    axis: tuple[float, float, float] | None
    onset: float
    travel: float
    base: float = 0.0


class Folds:
    """All fold systems of one layer: ``fields``, (N, K) metres, with K twice the number of systems."""

    def __init__(self, systems: list[System]) -> None:
        self._systems = systems
        pairs = [(s.envelope * np.sin(s.phase), s.envelope * np.cos(s.phase)) for s in systems]
        self.fields = np.stack([field for pair in pairs for field in pair], axis=1)

    def mapped(self, matrix: csr_matrix) -> Folds:
        """The same folds at other points, whose attributes are ``matrix``, (M, N), times those of these."""
        folds = Folds(self._systems)
        folds.fields = matrix @ self.fields
        return folds

    def coefficients(self, pose: dict[str, np.ndarray]) -> np.ndarray:
        """(K,) amplitudes at a pose, given as axis-angle (3,) by joint name."""
        return np.concatenate([_drive(system, pose) for system in self._systems])

    def displacement(self, pose: dict[str, np.ndarray]) -> np.ndarray:
        """(N,) displacements along the normal at a pose, metres."""
        return self.fields @ self.coefficients(pose)


def _drive(system: System, pose: dict[str, np.ndarray]) -> np.ndarray:
    vector = np.sum([pose[name] for name in system.joints], axis=0)
    if system.axis is None:
        along = float(vector @ vector)
    else:
        along = max(float(vector @ np.array(system.axis)), 0.0) ** 2
    amplitude = system.base + (1 - system.base) * along / (along + system.onset**2)
    # Linear far from rest, and even at rest, so that it is a smooth function of the pose.
    shift = system.travel * (np.sqrt(along + 0.04) - 0.2)
    return amplitude * np.array([np.cos(shift), np.sin(shift)])
