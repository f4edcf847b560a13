"""The multiresolution hash grid (Müller et al. 2022) in float64, from the same table."""

from __future__ import annotations

import itertools

import numpy as np

from ndf_mi.field import Preset

PRIMES = (1, 2654435761, 805459861)
"""Of the paper's hash, by coordinate."""


class Grid64:
    """A hash grid over the unit cube, its last coordinate scaled by `grid_l_scale`.

    Args:
        shape: with the encoding `grid`.
        table: (size,) entries by level, node and feature.

    Raises:
        ValueError: the table is larger than the levels.
    """

    def __init__(self, shape: Preset, table: np.ndarray) -> None:
        growth = np.log(shape.grid_finest / shape.grid_base) / (shape.grid_levels - 1)
        # A level with n nodes per side has n − 1 cells between its first and its last node.
        self.scales = shape.grid_base * np.exp(growth * np.arange(shape.grid_levels)) - 1
        self._stretch = np.array([1.0, 1.0, shape.grid_l_scale])
        self._levels: list[np.ndarray] = []
        rest = table.astype(np.float64).reshape(-1, shape.grid_features)
        for scale in self.scales:
            side = self._side(scale)
            count = min(shape.grid_features * -(-(side**3) // shape.grid_features), shape.grid_entries)
            self._levels.append(rest[:count])
            rest = rest[count:]
        if len(rest):
            raise ValueError(f"{len(rest)} nodes more than the levels have")

    def __call__(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Features at u (N, 3).

        Returns:
            features (N, K); the derivatives of their sum in u (N, 3), zero across a side of the cube that u
            is beyond; and the distance in cells to the nearest side of a cell, where derivatives jump, over
            all levels (N,).
        """
        inside = np.clip(u.astype(np.float64), 0, 1)
        moves = (inside == u) * self._stretch
        features, slopes, border = [], np.zeros(u.shape), np.full(len(u), np.inf)
        for scale, values in zip(self.scales, self._levels, strict=True):
            place = inside * self._stretch * scale + 0.5
            first = np.floor(place).astype(np.int64)
            part = place - first
            border = np.minimum(border, np.minimum(part, 1 - part).min(1))
            sums = np.zeros((len(u), values.shape[1]))
            for corner in itertools.product((0, 1), repeat=3):
                entry = values[self._index(first + corner, self._side(scale), len(values))]
                weights = np.where(corner, part, 1 - part)
                sums += weights.prod(1)[:, None] * entry
                for axis in range(3):
                    others = np.delete(weights, axis, 1).prod(1)
                    slopes[:, axis] += (
                        (1 if corner[axis] else -1) * others * scale * moves[:, axis] * entry.sum(1))
            features.append(sums)
        return np.concatenate(features, 1), slopes, border

    @staticmethod
    def _side(scale: float) -> int:
        return int(np.ceil(scale - 1e-9)) + 1

    @staticmethod
    def _index(node: np.ndarray, side: int, count: int) -> np.ndarray:
        if side**3 <= count:
            index = (node * side ** np.arange(3)).sum(1)
        else:
            index = np.bitwise_xor.reduce((node * np.array(PRIMES)) & 0xFFFFFFFF, axis=1)
        return index % count
