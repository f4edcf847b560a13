"""The convolutions of Neural Body: from codes at the sites to features at every stride."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.methods.neural_body.architecture import Architecture
from ndf_mi.methods.neural_body.convolution import WINDOW, convolve, normalise
from ndf_mi.methods.neural_body.voxels import MISSING, Voxels, Window


@dataclass(frozen=True)
class DeviceWindow:
    """A window's tables, flat, padded by `MISSING` to the rows of both sides."""

    inputs: mi.Int32
    outputs: mi.Int32


@dataclass(frozen=True)
class DeviceStride:
    """What the convolutions of a stride need of the voxels.

    Attributes:
        rows: sites with the padding.
        keys: (N,) places of the sites in the flattened box.
        mean: (1, rows) weights whose product with features is their mean over the sites.
        same, down: as in `Stride`.
    """

    rows: int
    keys: mi.UInt32
    mean: mi.TensorXf
    same: DeviceWindow
    down: DeviceWindow | None


@dataclass(frozen=True)
class DeviceVoxels:
    """Voxels where the convolutions run.

    Attributes:
        site: (V,) row of the first stride that a vertex's code is added to.
        share: (V,) one over the number of vertices there.
        strides: 1, 2, 4, …
        bytes: what all this takes.
    """

    site: mi.UInt32
    share: mi.Float
    strides: tuple[DeviceStride, ...]
    bytes: int


def place(found: Voxels, rows: tuple[int, ...]) -> DeviceVoxels:
    """Voxels, with the sites of each stride padded to at least so many rows."""
    rows = tuple(max(least, padded(len(stride.sites))) for least, stride in
                 zip(rows, found.strides, strict=True))
    strides = []
    for number, (stride, count) in enumerate(zip(found.strides, rows, strict=True)):
        mean = np.zeros((1, count), np.float32)
        mean[:, : len(stride.sites)] = 1 / len(stride.sites)
        down = None if stride.down is None else _window(stride.down, rows[number - 1], count)
        strides.append(DeviceStride(count, mi.UInt32(stride.keys.astype(np.uint32)), mi.TensorXf(mean),
                                    _window(stride.same, count, count), down))
    tables = sum(2 * WINDOW * count for count in rows) + sum(WINDOW * (a + b) for a, b in
                                                             zip(rows, rows[1:], strict=False))
    return DeviceVoxels(mi.UInt32(found.site.astype(np.uint32)), mi.Float(1 / found.count[found.site]),
                        tuple(strides), 4 * (tables + 2 * sum(rows) + 2 * len(found.site)))


def padded(count: int) -> int:
    """The next of eight sizes an octave, and at least a multiple of 64."""
    step = max(64, 1 << max(count.bit_length() - 4, 0))
    return -(-count // step) * step


class Encoder:
    """The convolutions of an architecture, each with batch normalisation and ReLU. Statistics are those of
    the present pose, in images too, as the authors' release renders (its network stays in training mode).

    Their tensor is flat: for each convolution the matrix (27·in, out), scales and shifts.
    """

    def __init__(self, architecture: Architecture) -> None:
        self._code = architecture.code
        self._convolutions = architecture.convolutions
        sizes = [WINDOW * inputs * outputs + 2 * outputs for _, inputs, outputs, _ in self._convolutions]
        self._offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(int).tolist()

    @property
    def size(self) -> int:
        """Number of weights."""
        return self._offsets[-1]

    def initial(self, rng: np.random.Generator) -> np.ndarray:
        """Matrices uniform in ±1/√(fan-in), scales 1, shifts 0; float32."""
        parts = []
        for _, inputs, outputs, _ in self._convolutions:
            bound = 1 / np.sqrt(WINDOW * inputs)
            parts += [rng.uniform(-bound, bound, WINDOW * inputs * outputs), np.ones(outputs),
                      np.zeros(outputs)]
        return np.concatenate(parts).astype(np.float32)

    def __call__(self, weights: mi.Float, codes: mi.Float, on: DeviceVoxels) -> list[mi.Float]:
        """Features at strides 2, 4, …: flat (rows, channels) each; attached, in reverse mode only.

        Args:
            weights: the flat tensor.
            codes: flat (V, code). Where several vertices share a site, it has the mean of their codes.
        """
        code = self._code
        lane = dr.arange(mi.UInt32, dr.width(on.site) * code)
        vertex = lane // code
        x = dr.zeros(mi.Float, on.strides[0].rows * code)
        dr.scatter_add(x, codes * dr.gather(mi.Float, on.share, vertex),
                       dr.gather(mi.UInt32, on.site, vertex) * code + (lane - vertex * code))
        found: dict[int, mi.Float] = {}
        for number, (stride, inputs, outputs, down) in enumerate(self._convolutions):
            at = on.strides[stride]
            window = at.down if down else at.same
            assert window is not None
            offset, size = self._offsets[number], WINDOW * inputs * outputs
            matrix = mi.TensorXf(_slice(weights, offset, size), (WINDOW * inputs, outputs))
            scale = _slice(weights, offset + size, outputs)
            shift = _slice(weights, offset + size + outputs, outputs)
            dr.eval(x, matrix)
            x = normalise(convolve(x, matrix, window.inputs, window.outputs), scale, shift, at.mean)
            found[stride] = x
        return [found[stride] for stride in sorted(found) if stride > 0]


def _slice(values: mi.Float, offset: int, count: int) -> mi.Float:
    return dr.gather(mi.Float, values, offset + dr.arange(mi.UInt32, count))


def _window(window: Window, inputs: int, outputs: int) -> DeviceWindow:
    """A window of `inputs` rows that lead to `outputs` rows."""
    return DeviceWindow(_padded(window.inputs, outputs), _padded(window.outputs, inputs))


def _padded(table: np.ndarray, rows: int) -> mi.Int32:
    more = np.full((rows - len(table), WINDOW), MISSING, np.int32)
    return mi.Int32(np.concatenate([table, more]).ravel())
