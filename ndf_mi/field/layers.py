"""The layers of a preset, the flat vector that holds their weights, and their matrices in it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field.encoding import frequency_width
from ndf_mi.field.presets import Preset


@dataclass(frozen=True)
class Layer:
    """An affine layer. The pose features are the same for all samples. They come last among the inputs, so
    that their columns can be folded into the bias once a pose.

    Attributes:
        name: see :func:`layout`.
        inputs: width of the inputs that change with the sample.
        pose: width of the pose features that are joined, or 0.
        outputs: width of the output.
        offset: where the (outputs, inputs + pose) matrix starts in the flat vector, row by row. The bias
            follows it, and then the products.
        products: whether the pose features also mix matrices. An (outputs·inputs, pose) matrix holds one
            matrix a column.
    """

    name: str
    inputs: int
    pose: int
    outputs: int
    offset: int = 0
    products: bool = False

    @property
    def affine(self) -> int:
        """Number of weights before the products: the matrix with the pose's columns, and the bias."""
        return self.outputs * (self.inputs + self.pose + 1)

    @property
    def size(self) -> int:
        """Number of weights, bias and products included."""
        return self.affine + (self.outputs * self.inputs * self.pose if self.products else 0)


def layout(preset: Preset, joints: int) -> dict[str, Layer]:
    """The layers of a preset for a body with `joints` joints, by name, in the order of the flat vector.

    Names: ``pose0…`` (pose features), ``deform0…`` (D), ``density0…`` and ``density_out`` (M_σ),
    ``linear0…``, ``colour0…`` and ``colour_out`` (M_c).
    """
    layers: list[Layer] = []

    def add(name: str, inputs: int, pose: int, outputs: int) -> int:
        offset = layers[-1].offset + layers[-1].size if layers else 0
        layers.append(Layer(name, inputs, pose, outputs, offset, products=preset.pose_products and pose > 0))
        return outputs

    width = 3 * joints
    for i, w in enumerate(preset.pose_layers):
        width = add(f"pose{i}", width, 0, w)
    pose = width if preset.pose_layers else 0

    if preset.deformation_layers:
        width = frequency_width(preset.dimension, preset.deformation_octaves)
        for i, w in enumerate(preset.deformation_layers):
            width = add(f"deform{i}", width, pose if i == 0 else 0, w)
        add("deform_out", width, 0, preset.dimension)

    frequencies = frequency_width(preset.dimension, preset.octaves)
    encoded = frequencies if preset.encoding == "frequency" else preset.grid_levels * preset.grid_features
    width = encoded
    for i, w in enumerate(preset.density_layers):
        joined = preset.density_skip > 0 and i == preset.density_skip
        width = add(f"density{i}", width + (encoded if joined else 0), pose if i == 0 or joined else 0, w)
    add("density_out", width, 0, 1 + preset.feature_width)

    width = preset.feature_width or width
    for i, w in enumerate(preset.colour_linear):
        width = add(f"linear{i}", width, pose if i == 1 else 0, w)
    joined_pose = pose if not preset.colour_linear else 0
    if preset.direction_octaves >= 0:
        width += frequency_width(3, preset.direction_octaves)
    if preset.normal_octaves >= 0:
        width += frequency_width(3, preset.normal_octaves)
    for i, w in enumerate(preset.colour_layers):
        width = add(f"colour{i}", width, joined_pose if i == 0 else 0, w)
    add("colour_out", width, 0, 3)
    return {layer.name: layer for layer in layers}


def initial_weights(layers: dict[str, Layer], rng: np.random.Generator) -> np.ndarray:
    """Untrained weights, float32: uniform in ±1/√(fan-in) for matrices and biases. D's last layer has a
    hundredth of that, so that training starts undeformed. Products with the pose start at zero."""
    parts = []
    for layer in layers.values():
        bound = 1.0 / np.sqrt(layer.inputs + layer.pose)
        if layer.name == "deform_out":
            bound *= 0.01
        parts += [rng.uniform(-bound, bound, layer.affine), np.zeros(layer.size - layer.affine)]
    return np.concatenate(parts).astype(np.float32)


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
        index = layer.offset + row * columns + first + (index - row * count)
        return mi.TensorXf(dr.gather(mi.Float, weights, index), (layer.outputs, count))

    lane = layer.offset + layer.outputs * columns + dr.arange(mi.UInt32, layer.outputs)
    bias = dr.gather(mi.Float, weights, lane)
    return (block(0, layer.inputs), mi.TensorXf(bias, (layer.outputs, 1)),
            block(layer.inputs, layer.pose) if layer.pose else None)


def products(weights: mi.Float, layer: Layer, features: mi.TensorXf) -> mi.TensorXf:
    """Σ_k f_k·W_k, which pose features f, (pose, 1), add to a layer's matrix (outputs, inputs)."""
    count = layer.outputs * layer.inputs
    index = layer.offset + layer.affine + dr.arange(mi.UInt32, layer.size - layer.affine)
    mixed = mi.TensorXf(dr.gather(mi.Float, weights, index), (count, layer.pose))
    return mi.TensorXf((mixed @ features).array, (layer.outputs, layer.inputs))
