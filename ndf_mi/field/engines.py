"""Two ways to run layers on many samples: matrix products, and cooperative vectors with a sample a lane."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import drjit as dr
import drjit.nn as nn
import mitsuba as mi

Tensors: TypeAlias = "Mapping[str, tuple[mi.TensorXf, mi.TensorXf]]"
"""Matrix (outputs, inputs) and bias (outputs, 1) of each layer, by name."""

Views: TypeAlias = Mapping[str, tuple[Any, Any]]
"""The same as views of one packed array (:func:`pack`)."""


def pack(tensors: Tensors, half: bool = False) -> Views:
    """Lays matrices and biases out for cooperative vectors, in half precision if `half`; attached."""
    kind = mi.TensorXf16 if half else mi.TensorXf
    flat = [t if t.ndim == 2 and t.shape[1] > 1 else dr.ravel(t) for pair in tensors.values() for t in pair]
    views = nn.pack(*[kind(t) for t in flat], layout="training")
    return {name: (views[2 * i], views[2 * i + 1]) for i, name in enumerate(tensors)}


class Batched:
    """Tensors of shape (features, N) between layers."""

    def __init__(self, tensors: Tensors, width: int) -> None:
        self._tensors = tensors
        self._width = width

    def enter(self, *parts: Any) -> mi.TensorXf:
        """Joins parts, lists of arrays or outputs of layers, into a layer's input, with a row of ones below
        them. A layer's bias then is a column of its matrix, which costs the product next to nothing; adding
        it to every row afterwards costs more than the product."""
        parts = (*parts, [dr.full(mi.Float, 1.0, self._width)])
        arrays: list[Any] = []
        rows = 0
        for part in parts:
            if isinstance(part, list):
                arrays += [
                    p if dr.width(p) == self._width else p + dr.zeros(mi.Float, self._width) for p in part
                ]
                rows += len(part)
            else:
                arrays.append(part.array)
                rows += part.shape[0]
        return mi.TensorXf(arrays[0] if len(arrays) == 1 else dr.concat(arrays), (rows, self._width))

    def linear(self, name: str, x: mi.TensorXf) -> mi.TensorXf:
        """Applies an affine layer."""
        weight, bias = self._tensors[name]
        if x.shape[0] > weight.shape[1]:
            return dr.concat([weight, bias], axis=1) @ x
        return weight @ x + bias

    def rows(self, x: mi.TensorXf) -> list[mi.Float]:
        """A layer's outputs as arrays."""
        index = dr.arange(mi.UInt32, self._width)
        return [dr.gather(mi.Float, x.array, index + row * self._width) for row in range(x.shape[0])]

    def head(self, x: mi.TensorXf) -> tuple[mi.Float, mi.TensorXf]:
        """The first output as an array, and the others as an input of layers."""
        index = dr.arange(mi.UInt32, self._width)
        rest = dr.arange(mi.UInt32, (x.shape[0] - 1) * self._width) + self._width
        return (dr.gather(mi.Float, x.array, index),
                mi.TensorXf(dr.gather(mi.Float, x.array, rest), (x.shape[0] - 1, self._width)))


class Fused:
    """Cooperative vectors between layers, with the methods of :class:`Batched`; traceable in symbolic
    code.

    Attributes:
        finite: whether every layer's output has been finite so far, for `half` precision. An infinity stays
            one or becomes NaN in later layers.
    """

    def __init__(self, views: Views, half: bool = False) -> None:
        self._views = views
        self._kind = mi.Float16 if half else mi.Float
        self._half = half
        self.finite = mi.Bool(True)

    def enter(self, *parts: Any) -> Any:
        return nn.CoopVec(*[self._kind(entry) for part in parts for entry in part])

    def linear(self, name: str, x: Any) -> Any:
        weight, bias = self._views[name]
        out = nn.matvec(weight, x, bias)
        if self._half:
            for entry in out:
                self.finite = self.finite & dr.isfinite(mi.Float(entry))
        return out

    def rows(self, x: Any) -> list[mi.Float]:
        return [mi.Float(entry) for entry in x]

    def head(self, x: Any) -> tuple[mi.Float, Any]:
        entries = list(x)
        return mi.Float(entries[0]), nn.CoopVec(*entries[1:])
