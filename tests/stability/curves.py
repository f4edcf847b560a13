"""The logistic function and the sRGB curve (IEC 61966-2-1) with their derivatives, float64."""

from __future__ import annotations

import numpy as np


def logistic(x: np.ndarray) -> np.ndarray:
    """1 / (1 + e^−x), without overflow."""
    small = np.exp(-np.abs(x))
    return np.where(x < 0, small, 1.0) / (1.0 + small)


def decode(srgb: np.ndarray) -> np.ndarray:
    """From sRGB to linear."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0.04045) + 0.055) / 1.055) ** 2.4)


def decode_slope(srgb: np.ndarray) -> np.ndarray:
    """The derivative of :func:`decode`."""
    return np.where(srgb <= 0.04045, 1 / 12.92, 2.4 / 1.055 * ((np.maximum(srgb, 0) + 0.055) / 1.055) ** 1.4)


def encode(linear: np.ndarray) -> np.ndarray:
    """From linear to sRGB."""
    return np.where(
        linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def encode_slope(linear: np.ndarray) -> np.ndarray:
    """The derivative of :func:`encode`."""
    return np.where(linear <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(linear, 0.0031308) ** (1 / 2.4 - 1))
