"""The sRGB transfer curve (IEC 61966-2-1) and its inverse, for numpy arrays and for Dr.Jit types alike.

Radiance inside the renderer is linear; images on disk, losses and metrics are sRGB.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

_LINEAR_TOE = 0.0031308
_SRGB_TOE = 0.04045


def linear_to_srgb(value: Any) -> Any:
    """Encode linear intensities as sRGB.

    `value` is a numpy array, a number, or a Dr.Jit array or tensor of any shape; the same kind comes back. Negative values stay on
    the linear toe and values above 1 continue the power law, so that nothing is clamped and gradients flow everywhere. The power's
    argument is guarded, which keeps the gradient finite at 0 (it is 12.92 there).
    """
    if _is_numpy(value):
        return np.where(value <= _LINEAR_TOE, value * 12.92, 1.055 * np.maximum(value, _LINEAR_TOE) ** (1 / 2.4) - 0.055)
    return dr.select(
        value <= _LINEAR_TOE, value * 12.92, dr.fma(dr.power(dr.maximum(value, _LINEAR_TOE), 1 / 2.4), 1.055, -0.055)
    )


def srgb_to_linear(value: Any) -> Any:
    """Decode sRGB to linear intensities; the inverse of `linear_to_srgb`, with the same kinds accepted."""
    if _is_numpy(value):
        return np.where(value <= _SRGB_TOE, value / 12.92, ((np.maximum(value, _SRGB_TOE) + 0.055) / 1.055) ** 2.4)
    return dr.select(
        value <= _SRGB_TOE, value / 12.92, dr.power((dr.maximum(value, _SRGB_TOE) + 0.055) / 1.055, 2.4)
    )


def _is_numpy(value: Any) -> bool:
    return isinstance(value, (np.ndarray, np.generic, float, int))
