"""Encodings of coordinates: frequency (γ) and the multiresolution hash grid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

from ndf_mi.field.presets import Preset


def frequency(values: Sequence[mi.Float], octaves: int) -> list[mi.Float]:
    """γ: each value raw, then its sine and cosine at 2⁰ … 2^(octaves−1), without a factor π.

    Ordered as the values first, then octave by octave: sines of all values, cosines of all values. Returns
    ``len(values) · (1 + 2·octaves)`` entries. Each octave's sines are computed directly: the double-angle
    recurrence would lose a bit an octave.
    """
    out = list(values)
    for octave in range(octaves):
        pairs = [dr.sincos(v * float(2**octave)) for v in values]
        out += [s for s, _ in pairs]
        out += [c for _, c in pairs]
    return out


def frequency_width(values: int, octaves: int) -> int:
    """Number of entries that :func:`frequency` returns for `values` values."""
    return values * (1 + 2 * octaves)


class GridEncoding:
    """A multiresolution hash grid over ũ, coarser along l (Müller et al. 2022, *Instant Neural Graphics
    Primitives*).

    The table is passed to each call, so that it can be a parameter of a medium or of an optimiser.

    Attributes:
        width: number of features.
        size: number of the table's entries.
    """

    def __init__(self, preset: Preset) -> None:
        growth = (preset.grid_finest / preset.grid_base) ** (1.0 / (preset.grid_levels - 1))
        self._encoding = nn.HashGridEncoding(
            mi.Float, preset.dimension, n_levels=preset.grid_levels,
            n_features_per_level=preset.grid_features, hashmap_size=preset.grid_entries,
            base_resolution=preset.grid_base, per_level_scale=growth,
        )
        self._encoding.data = None
        self._scale = [1.0] * preset.dimension
        if preset.coordinates != "world":
            self._scale[-1] = preset.grid_l_scale
        self.width = preset.grid_levels * preset.grid_features
        self.size = int(self._encoding.n_params)

    def initial(self, rng: np.random.Generator) -> np.ndarray:
        """An untrained table, uniform in ±1e-4; float32, shape (size,)."""
        return rng.uniform(-1e-4, 1e-4, self.size).astype(np.float32)

    def __call__(self, table: mi.Float, u: Any, active: mi.Bool | bool = True) -> list[mi.Float]:
        """Features at ũ, as many values as the preset's `dimension`, clamped to the unit cube; attached to
        both."""
        u = [dr.clip(value, 0.0, 1.0) * scale for value, scale in zip(u, self._scale, strict=True)]
        self._encoding.data = table
        try:
            return list(self._encoding(u, active))
        finally:
            self._encoding.data = None
