"""The numbers that training changes, and each layer's matrices among them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field.layers import Layer


@dataclass(frozen=True)
class FieldParameters:
    """The numbers that training changes.

    Attributes:
        weights: flat float32 vector of all layers, in the order of :func:`ndf_mi.field.layers.layout`.
        grid: flat float32 hash table, or None where the preset has none.
    """

    weights: mi.Float
    grid: mi.Float | None = None

    def replace(self, **changes: mi.Float) -> FieldParameters:
        """The same with some of them exchanged, by name."""
        return dataclasses.replace(self, **changes)

    def detached(self) -> FieldParameters:
        """The same values without gradients."""
        return FieldParameters(dr.detach(self.weights), None if self.grid is None else dr.detach(self.grid))

    def arrays(self) -> dict[str, np.ndarray]:
        """Numpy arrays by name; `grid` only where there is one."""
        arrays = {"weights": self.weights.numpy()}
        if self.grid is not None:
            arrays["grid"] = self.grid.numpy()
        return arrays


def matrices(weights: mi.Float, layer: Layer) -> tuple[mi.TensorXf, mi.TensorXf, mi.TensorXf | None]:
    """A layer's matrix (outputs, inputs), bias (outputs, 1) and pose columns (outputs, pose) or None,
    attached to the weights."""
    columns = layer.inputs + layer.pose

    def block(first: int, count: int) -> mi.TensorXf:
        index = dr.arange(mi.UInt32, layer.outputs * count)
        row = index // count
        return mi.TensorXf(
            dr.gather(mi.Float, weights, layer.offset + row * columns + first + (index - row * count)),
            (layer.outputs, count),
        )

    bias = dr.gather(
        mi.Float, weights, layer.offset + layer.outputs * columns + dr.arange(mi.UInt32, layer.outputs)
    )
    return (block(0, layer.inputs), mi.TensorXf(bias, (layer.outputs, 1)),
            block(layer.inputs, layer.pose) if layer.pose else None)


def products(weights: mi.Float, layer: Layer, features: mi.TensorXf) -> mi.TensorXf:
    """Σ_k f_k·W_k, which pose features f, (pose, 1), add to a layer's matrix (outputs, inputs)."""
    count = layer.outputs * layer.inputs
    index = layer.offset + layer.affine + dr.arange(mi.UInt32, layer.size - layer.affine)
    mixed = mi.TensorXf(dr.gather(mi.Float, weights, index), (count, layer.pose))
    return mi.TensorXf((mixed @ features).array, (layer.outputs, layer.inputs))
