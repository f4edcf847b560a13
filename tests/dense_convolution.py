"""Dense convolutions in double precision by SciPy: what sparse ones are held against."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def dense(values, stride):
    """(…, channels) on the whole box of a stride, zero where there is no site."""
    grid = np.zeros((*stride.shape, values.shape[1]))
    grid[tuple(stride.sites.T)] = values
    return grid


def correlated(grid, weight):
    """The convolution of (…, inputs) with (27·inputs, outputs), as in PyTorch without flipping the window:
    (…, outputs).
    """
    kernel = weight.reshape(3, 3, 3, -1, weight.shape[1])
    return np.stack([sum(ndimage.correlate(grid[..., c], kernel[..., c, o], mode="constant")
                         for c in range(grid.shape[-1])) for o in range(weight.shape[1])], -1)
