"""The box around a posed body: training samples pixels in it, and "box" metrics are measured over it."""

from __future__ import annotations

import numpy as np

BOX_PADDING = 0.05
"""Metres by which the body's axis-aligned box grows on every side, as in Neural Body and NDF: room for
clothes and hair. All box metrics use it, also for runs trained with another `box_padding`, so that they stay
comparable."""


def padded_box(vertices: np.ndarray, padding: float = BOX_PADDING) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner, (3,) float64, of the box of `vertices` (V, 3), grown by `padding` metres."""
    points = np.asarray(vertices, dtype=np.float64)
    return points.min(axis=0) - padding, points.max(axis=0) + padding
