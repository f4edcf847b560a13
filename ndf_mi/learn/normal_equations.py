"""Normal equations of least squares whose unknowns belong to frames or to all of them, with a prior that
couples neighbouring frames number by number.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded


class NormalEquations:
    """The minimum over y (T, n) and s (m,) of

        Σ_rows w (r - a·y_t - b·s)² + Σ_k (y_k + z_k)ᵀ P (y_k + z_k) + |s + c|²

    with the precision P (T, T) of :func:`precision` for each of the n numbers k of a frame. The matrix of all
    y is banded; s is eliminated through its Schur complement.

    Args:
        pose: (T, n) z; n may be 0.
        shared: (m,) c; m may be 0.
        links: the diagonal of P, and the entries next to it.
    """

    def __init__(self, pose: np.ndarray, shared: np.ndarray, links: tuple[np.ndarray, np.ndarray]) -> None:
        (frames, count), common = pose.shape, len(shared)
        kept, link = links
        self._link = link
        self._diagonal = kept[:, None, None] * np.eye(count)
        self._border = np.zeros((frames, count, common))
        self._pull = -kept[:, None] * pose
        self._pull[:-1] -= link[:, None] * pose[1:]
        self._pull[1:] -= link[:, None] * pose[:-1]
        self._common, self._common_pull = np.eye(common), -shared

    def add(self, frame: int, own: np.ndarray, shared: np.ndarray, distance: np.ndarray,
            weight: np.ndarray) -> None:
        """Adds N rows.

        Args:
            frame: t, the index of their frame.
            own, shared: a (N, n) and b (N, m).
            distance, weight: r and w, (N,).
        """
        heavy, heavy_shared = weight[:, None] * own, weight[:, None] * shared
        self._diagonal[frame] += own.T @ heavy
        self._border[frame] += own.T @ heavy_shared
        self._pull[frame] += heavy.T @ distance
        self._common += shared.T @ heavy_shared
        self._common_pull += heavy_shared.T @ distance

    def solve(self) -> tuple[np.ndarray, np.ndarray]:
        """(T, n) y and (m,) s."""
        frames, count, common = self._border.shape
        if not count:
            return np.zeros((frames, 0)), np.linalg.solve(self._common, self._common_pull)
        right = np.concatenate([self._pull[..., None], self._border], axis=2)
        solved = solveh_banded(self._banded(), right.reshape(frames * count, -1), overwrite_ab=True)
        border = self._border.reshape(frames * count, common)
        shared = np.linalg.solve(self._common - border.T @ solved[:, 1:],
                                 self._common_pull - border.T @ solved[:, 0])
        return (solved[:, 0] - solved[:, 1:] @ shared).reshape(frames, count), shared

    def _banded(self) -> np.ndarray:
        """The matrix of all y in the upper form of `scipy.linalg.solveh_banded`."""
        frames, count, _ = self._diagonal.shape
        upper = np.zeros((count + 1, frames * count))
        for column in range(count):
            upper[count - column :, column::count] = self._diagonal[:, : column + 1, column].T
        upper[0, count:] = np.repeat(self._link, count)
        return upper


def precision(frames: np.ndarray, correlation: float) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of the covariance exp(-|Δ|/τ) of frames: its diagonal (T,) and the entries next to that
    (T - 1,). All others are zero, since the process is Markov's.

    Args:
        frames: (T,) ascending numbers.
        correlation: τ, frames; 0 makes frames independent.
    """
    apart = np.diff(frames).astype(np.float64)
    kept = np.exp(-apart / correlation) if correlation > 0 else np.zeros(len(apart))
    gain = kept / (1 - kept**2)
    diagonal = np.ones(len(frames))
    diagonal[1:] += kept * gain
    diagonal[:-1] += kept * gain
    return diagonal, -gain
