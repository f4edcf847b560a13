"""Sparse convolutions: gather, matrix product, and in reverse the same with the transposed window.

Features are flat arrays of rows, (rows, channels): a site's channels are adjacent, which gathers like. Rows
beyond the sites pad them to a number that changes rarely, as sizes are compiled into kernels; nothing sees
them.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

WINDOW = 27


class _Convolution(dr.CustomOp):
    """y[o] = Σ_k x[inputs[o, k]]·W_k. Dr.Jit's own derivative of the gather would add atomically; each input
    instead gathers what the outputs that see it send, since there is at most one at each place.
    """

    def eval(self, x: mi.Float, weight: mi.TensorXf, inputs: mi.Int32, outputs: mi.Int32) -> mi.Float:
        self._channels = weight.shape[0] // WINDOW
        self._x, self._weight, self._inputs, self._outputs = x, weight, inputs, outputs
        rows = dr.width(inputs) // WINDOW
        columns = WINDOW * self._channels
        lane = dr.arange(mi.UInt32, rows * columns)
        place = lane // self._channels
        source = dr.gather(mi.Int32, inputs, place)
        seen = dr.gather(mi.Float, x, mi.UInt32(source) * self._channels + (lane - place * self._channels),
                         source >= 0)
        return (mi.TensorXf(seen, (rows, columns)) @ weight).array

    def forward(self) -> None:
        raise NotImplementedError("sparse convolutions have derivatives in reverse mode only")

    def backward(self) -> None:
        c, rows = self._channels, dr.width(self._inputs) // WINDOW
        gradient = mi.TensorXf(self.grad_out(), (rows, self._weight.shape[1]))
        # The transposed columns: this product runs along the rows, and is five times faster this way round.
        lane = dr.arange(mi.UInt32, WINDOW * c * rows)
        column = lane // rows
        row, k = lane - column * rows, column // c
        source = dr.gather(mi.Int32, self._inputs, row * WINDOW + k)
        seen = dr.gather(mi.Float, self._x, mi.UInt32(source) * c + (column - k * c), source >= 0)
        self.set_grad_in("weight", mi.TensorXf(seen, (WINDOW * c, rows)) @ gradient)
        sent = (gradient @ self._weight.T).array
        lane = dr.arange(mi.UInt32, dr.width(self._x))
        site = lane // c
        channel, total = lane - site * c, mi.Float(0)
        for k in range(WINDOW):
            to = dr.gather(mi.Int32, self._outputs, site * WINDOW + k)
            total = total + dr.gather(mi.Float, sent, (mi.UInt32(to) * WINDOW + k) * c + channel, to >= 0)
        self.set_grad_in("x", total)

    def name(self) -> str:
        return "sparse convolution"


def convolve(x: mi.Float, weight: mi.TensorXf, inputs: mi.Int32, outputs: mi.Int32) -> mi.Float:
    """A convolution with a 3³ window, without bias.

    Args:
        x: flat (rows in, channels in), evaluated.
        weight: (27·channels in, channels out), the window's places in the order of `voxels.OFFSETS`.
        inputs, outputs: the flattened `voxels.Window`, padded by `MISSING`.

    Returns:
        flat (rows out, channels out); attached to `x` and `weight`, in reverse mode only.
    """
    result: Any = dr.custom(_Convolution, x, weight, inputs, outputs)
    return result


class _Normalisation(dr.CustomOp):
    """max(x̂·scale + shift, 0) with x̂ = (x − mean) / √(variance + epsilon). Sums over the sites are matrix
    products; Dr.Jit's own derivatives of what is broadcast would add atomically.
    """

    def eval(self, x: mi.Float, scale: mi.Float, shift: mi.Float, weights: mi.TensorXf, epsilon: float
             ) -> mi.Float:
        channels = dr.width(scale)
        self._shape = weights.shape[1], channels
        self._weights, self._scale = weights, scale
        self._channel = dr.arange(mi.UInt32, dr.width(x)) % channels
        centred = x - self._spread(self._mean(x))
        self._factor = dr.rsqrt(self._mean(dr.square(centred)) + epsilon)
        self._unit = centred * self._spread(self._factor)
        y = dr.maximum(dr.fma(self._unit, self._spread(scale), self._spread(shift)), 0)
        self._positive = y > 0
        return y

    def forward(self) -> None:
        raise NotImplementedError("normalisation has derivatives in reverse mode only")

    def backward(self) -> None:
        gradient = dr.select(self._positive, self.grad_out(), 0)
        dr.eval(gradient, self._unit)
        mean, along = self._mean(gradient), self._mean(gradient * self._unit)
        dr.eval(mean, along)
        count = dr.rcp(dr.gather(mi.Float, self._weights.array, 0))
        self.set_grad_in("shift", mean * count)
        self.set_grad_in("scale", along * count)
        rest = gradient - self._spread(mean) - self._unit * self._spread(along)
        self.set_grad_in("x", rest * self._spread(self._factor * self._scale))

    def name(self) -> str:
        return "batch normalisation"

    def _mean(self, values: mi.Float) -> mi.Float:
        return (self._weights @ mi.TensorXf(values, self._shape)).array

    def _spread(self, values: mi.Float) -> mi.Float:
        return dr.gather(mi.Float, values, self._channel)


def normalise(x: mi.Float, scale: mi.Float, shift: mi.Float, weights: mi.TensorXf, epsilon: float = 1e-3
              ) -> mi.Float:
    """Batch normalisation over a pose's sites, followed by ReLU; attached, in reverse mode only.

    Args:
        x: flat (rows, channels).
        scale, shift: (channels).
        weights: (1, rows), 1 over the number of sites at these, which come first, 0 at padding rows. No
            gradient may reach the outputs of these.
        epsilon: added to the variance, which is that of the population, as in PyTorch.
    """
    result: Any = dr.custom(_Normalisation, x, scale, shift, weights, epsilon)
    return result
