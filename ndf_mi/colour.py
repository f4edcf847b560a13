"""The sRGB transfer curve (IEC 61966-2-1) and its inverse, for NumPy arrays and Dr.Jit types.

Radiance inside the renderer is linear; images on disk, losses and metrics are sRGB.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

_LINEAR_TOE = 0.0031308
_SRGB_TOE = 0.04045


def linear_to_srgb(value: Any) -> Any:
    """Encodes linear intensities as sRGB.

    Nothing is clamped: negative values stay on the linear toe, values above 1 continue the power law. The
    gradient is finite everywhere (12.92 at 0).

    Args:
        value: a NumPy array, a number, or a Dr.Jit array or tensor of any shape.

    Returns:
        the same type as `value`.
    """
    if _is_numpy(value):
        return np.where(
            value <= _LINEAR_TOE, value * 12.92, 1.055 * np.maximum(value, _LINEAR_TOE) ** (1 / 2.4) - 0.055
        )
    return dr.select(
        value <= _LINEAR_TOE,
        value * 12.92,
        dr.fma(dr.power(dr.maximum(value, _LINEAR_TOE), 1 / 2.4), 1.055, -0.055),
    )


def srgb_to_linear(value: Any) -> Any:
    """Decodes sRGB to linear intensities: the inverse of :func:`linear_to_srgb`, for the same types."""
    if _is_numpy(value):
        return np.where(
            value <= _SRGB_TOE, value / 12.92, ((np.maximum(value, _SRGB_TOE) + 0.055) / 1.055) ** 2.4
        )
    return dr.select(
        value <= _SRGB_TOE, value / 12.92, dr.power((dr.maximum(value, _SRGB_TOE) + 0.055) / 1.055, 2.4)
    )


def _is_numpy(value: Any) -> bool:
    return isinstance(value, (np.ndarray, np.generic, float, int))
