"""The box around a posed body within which pixels are drawn for training and measured afterwards."""

from __future__ import annotations

import numpy as np

#: Metres by which the body's axis-aligned box is grown on every side, as in Neural Body and NDF: room for clothes and hair. All box
#: figures are over this box. It is also the default of the training option `box_padding`; a run that was trained with another is
#: measured with this one all the same, so that figures stay comparable.
BOX_PADDING = 0.05


def padded_box(vertices: np.ndarray, padding: float = BOX_PADDING) -> tuple[np.ndarray, np.ndarray]:
    """The lower and upper corner, (3,) float64 each, of the box of `vertices` (V, 3), grown by `padding` metres."""
    points = np.asarray(vertices, dtype=np.float64)
    return points.min(axis=0) - padding, points.max(axis=0) + padding
