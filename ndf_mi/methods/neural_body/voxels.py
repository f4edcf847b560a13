"""The voxels that a body's vertices fall into, at every stride, and which of them are neighbours.

Sites are those of SpConv: a submanifold convolution has its outputs where its inputs are; a strided one has
an output wherever its 3³ window holds an input. Output o of stride 2 sees the inputs 2o − 1 … 2o + 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndf_mi.errors import InputError

MOST_CELLS = 1 << 26
"""Largest number of voxels in the box of the second stride, whose rows are looked up by position."""
OFFSETS = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), -1).reshape(-1, 3)
"""(27, 3) places in a window relative to its middle; the order of a convolution's matrices."""
MISSING = -1


@dataclass(frozen=True)
class Window:
    """Which inputs the outputs of a convolution see.

    Attributes:
        inputs: (outputs, 27) int32 rows of the inputs, `MISSING` where there is none.
        outputs: (inputs, 27) int32 rows of the outputs that see an input, at the same places of the window.
    """

    inputs: np.ndarray
    outputs: np.ndarray


@dataclass(frozen=True)
class Stride:
    """The voxels of one stride.

    Attributes:
        shape: (3,) voxels of the box along x, y and z.
        sites: (N, 3) int64 voxels that hold something, in ascending order of their keys.
        same: the window of submanifold convolutions.
        down: the window of the convolution from the stride before; None at the first.
    """

    shape: tuple[int, int, int]
    sites: np.ndarray
    same: Window
    down: Window | None

    @property
    def keys(self) -> np.ndarray:
        """(N,) int64 places of the sites in the flattened box."""
        return _keys(self.sites, self.shape)


@dataclass(frozen=True)
class Voxels:
    """The voxels of a posed body.

    Attributes:
        site: (V,) int32 row of the first stride's site that a vertex falls into.
        count: (N,) float32 number of vertices in each of these.
        strides: 1, 2, 4, …
    """

    site: np.ndarray
    count: np.ndarray
    strides: tuple[Stride, ...]


def voxels(points: np.ndarray, shape: tuple[int, int, int], strides: int) -> Voxels:
    """The voxels of points.

    Args:
        points: (V, 3) in voxels of the box; each falls into the voxel whose centre is closest, and must lie
            in the box.
        shape: voxels of the box, multiples of 2^(strides − 1).
        strides: how many.

    Raises:
        InputError: the box has too many voxels.
    """
    cells = int(np.prod([-(-size // 2) for size in shape], dtype=np.float64))
    if cells > MOST_CELLS:
        raise InputError("Neural Body", f"a body in a box of {cells:,} voxels of twice the finest size",
                         f"at most {MOST_CELLS:,}", "Check that the capture's units are metres.")
    index = np.rint(points).astype(np.int64)
    keys, site, count = np.unique(_keys(index, shape), return_inverse=True, return_counts=True)
    sites = np.stack(np.unravel_index(keys, shape), -1)
    found = [Stride(shape, sites, _submanifold(sites, shape), None)]
    for _ in range(strides - 1):
        last = found[-1]
        small = last.shape[0] // 2, last.shape[1] // 2, last.shape[2] // 2
        # Where o = (i − offset) / 2 is whole, output o sees input i at that offset.
        twice = last.sites[:, None] - OFFSETS
        outputs = twice[(twice % 2 == 0).all(-1)] // 2
        outputs = outputs[((outputs >= 0) & (outputs < small)).all(-1)]
        sites = np.stack(np.unravel_index(np.unique(_keys(outputs, small)), small), -1)
        down = Window(_rows(2 * sites[:, None] + OFFSETS, last.sites, last.shape),
                      np.where((twice % 2 == 0).all(-1), _rows(twice // 2, sites, small), MISSING))
        found.append(Stride(small, sites, _submanifold(sites, small), down))
    return Voxels(site.astype(np.int32).ravel(), count.astype(np.float32), tuple(found))


def _submanifold(sites: np.ndarray, shape: tuple[int, ...]) -> Window:
    inputs = _rows(sites[:, None] + OFFSETS, sites, shape)
    # A site is seen by its neighbours at the opposite places of their windows.
    return Window(inputs, np.ascontiguousarray(inputs[:, ::-1]))


def _rows(wanted: np.ndarray, sites: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(…) int32 rows of the voxels `wanted` (…, 3) among ascending sites, `MISSING` for those not there."""
    known, keys = _keys(sites, shape), _keys(wanted, shape)
    row = np.minimum(np.searchsorted(known, keys), len(known) - 1)
    there = ((wanted >= 0) & (wanted < shape)).all(-1) & (known[row] == keys)
    return np.where(there, row, MISSING).astype(np.int32)


def _keys(sites: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(…) int64 places of voxels (…, 3) in the flattened box; meaningless outside of it."""
    return (sites[..., 0] * shape[1] + sites[..., 1]) * shape[2] + sites[..., 2]
