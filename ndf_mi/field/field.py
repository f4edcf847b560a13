"""The neural field of NDF: pose features, deformation net, density and colour, on given coordinates.

It knows nothing of meshes, scenes or files: its input is the projected point (u, v, l) scaled to the unit cube.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import drjit.nn as nn
import mitsuba as mi
import numpy as np

from ndf_mi import variants
from ndf_mi.colour import srgb_to_linear
from ndf_mi.field.encoding import GridEncoding, frequency
from ndf_mi.field.layers import Layer, initial_weights, layout
from ndf_mi.field.presets import Preset
from ndf_mi.numerics import saturated, softplus


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


class Field:
    """The networks of a preset: an architecture, without parameters.

    Attributes:
        preset: the architecture's options.
        joints: number J of the body's joints; the pose vector has 3·J entries.
        layers: the layers by name, and where each lies in the flat vector of weights.
    """

    def __init__(self, preset: Preset, joints: int) -> None:
        self.preset = preset
        self.joints = joints
        self.layers = layout(preset, joints)
        self.encoding = GridEncoding(preset) if preset.encoding == "grid" else None

    @property
    def size(self) -> int:
        """Number of the networks' weights, without the hash table."""
        return sum(layer.size for layer in self.layers.values())

    @property
    def grid_size(self) -> int:
        """Number of the hash table's entries; 0 without one."""
        return 0 if self.encoding is None else self.encoding.size

    @property
    def majorant(self) -> float:
        """A bound strictly above every density in 1/m, known from the activation alone."""
        return 1.05 * self.preset.density_limit

    def initial_parameters(self, seed: int = 0) -> FieldParameters:
        """Random parameters to start training from; the same for the same seed."""
        rng = np.random.default_rng(seed)
        weights = mi.Float(initial_weights(self.layers, rng))
        return FieldParameters(weights, None if self.encoding is None else mi.Float(self.encoding.initial(rng)))

    def bind(self, pose: mi.Float, parameters: FieldParameters) -> BoundField:
        """The field at one pose. Pose features are computed and folded into biases and matrices once for all samples.

        Args:
            pose: (3·J) axis-angles of the joints relative to their parents, in radians; the root's three are zero.
            parameters: as many as the architecture has; gradients flow to them.
        """
        return BoundField(self, pose, parameters)


class BoundField:
    """A :class:`Field` at one pose. :meth:`batched` and :meth:`fused` give the same values from the same weights.

    Attributes:
        preset, majorant: the field's.
        width: of the widest layer that a sample passes through.
    """

    def __init__(self, field: Field, pose: mi.Float, parameters: FieldParameters) -> None:
        self.preset = field.preset
        self.majorant = field.majorant
        self._layers = field.layers
        self._encoding = field.encoding
        self._grid = parameters.grid
        self._packed: dict[str, tuple[Any, Any]] | None = None
        self._half = False
        self._packed_detached: dict[str, tuple[Any, Any]] | None = None
        self.width = max(layer.outputs for name, layer in field.layers.items() if not name.startswith("pose"))

        features = mi.TensorXf(pose, (3 * field.joints, 1))
        for i in range(len(self.preset.pose_layers)):
            weight, bias, _ = _split(parameters.weights, self._layers[f"pose{i}"])
            features = dr.maximum(weight @ features + bias, 0)
        self._tensors: dict[str, tuple[mi.TensorXf, mi.TensorXf]] = {}
        for name, layer in self._layers.items():
            if not name.startswith("pose"):
                weight, bias, pose_weight = _split(parameters.weights, layer)
                if layer.products:
                    weight = weight + _products(parameters.weights, layer, features)
                self._tensors[name] = (weight, bias if pose_weight is None else pose_weight @ features + bias)

    def batched(self, u: Sequence[mi.Float], d: mi.Vector3f, n: mi.Normal3f) -> tuple[mi.Float, mi.Color3f]:
        """Density and colour by dense matrix products over all samples; for evaluated code.

        Args:
            u: u* of N points in the unit cube, as many arrays as the preset's `dimension`; every lane finite.
            d: N unit view directions in world space.
            n: N unit normals of the body's surface in world space; used where the preset says so.

        Returns:
            σ in 1/m, in [0, `density_limit`], and linear colour in [0, 1].
        """
        return self._evaluate(_Batched(self._tensors, dr.width(d)), u, d, n)

    def fused(
        self, u: Sequence[mi.Float], d: mi.Vector3f, n: mi.Normal3f, active: mi.Bool | bool = True
    ) -> tuple[mi.Float, mi.Color3f]:
        """The same through cooperative vectors: the only form that may be traced inside a symbolic loop, as in a medium.

        Call :meth:`pack` beforehand, outside of any symbolic code. Where half precision has overflowed, σ is NaN.
        """
        if self._packed is None:
            raise RuntimeError("BoundField.fused: call pack() first, outside of symbolic code")
        if not self._half:
            return self._evaluate(_Fused(self._packed), u, d, n, active)
        run = _Half(self._packed)
        sigma, colour = self._evaluate(run, u, d, n, active)
        return dr.select(run.finite, sigma, dr.nan), colour

    @property
    def packed(self) -> bool:
        """Whether :meth:`pack` has been called."""
        return self._packed is not None

    @property
    def half(self) -> bool:
        """Whether :meth:`pack` has laid the weights out in half precision."""
        return self._packed is not None and self._half

    @property
    def attached(self) -> bool:
        """Whether gradients are being tracked of any weight, of the hash table, or of the pose."""
        tensors = [part.array for pair in self._tensors.values() for part in pair]
        return any(dr.grad_enabled(value) for value in (*tensors, self._grid) if value is not None)

    def pack(self, half: bool | None = None) -> None:
        """Lays the weights out for :meth:`fused`; attached, so that gradients reach the field's weights.

        Args:
            half: weights, features and sums of the layers in half precision (11 bits, 6e-5 to 65,504; from there down to 6e-8 bits are
                lost one by one); encodings, activations of density and colour, and what is returned stay in single.
                None: only where the active variant has no other.
        """
        if half is None:
            half = "single" not in variants.cooperative_precisions()
        self._packed, self._half = _pack(self._tensors, half), half

    def density(self, u: Sequence[mi.Float], active: mi.Bool) -> mi.Float:
        """σ alone of :meth:`batched`, detached and evaluated, by whichever form is the quicker; for evaluated code.

        Args:
            u: as for :meth:`batched`.
            active: N lanes that are wanted.
        """
        with dr.suspend_grad():
            # Neither enters the density.
            nowhere = dr.full(mi.Vector3f, 1.0, dr.width(u[0]))
            if self.width > variants.fused_width():
                sigma, _ = self.batched(u, nowhere, mi.Normal3f(nowhere))
            else:
                if self._packed_detached is None:
                    self._packed_detached = _pack({name: (dr.detach(w), dr.detach(b)) for name, (w, b) in self._tensors.items()})
                sigma, _ = self._evaluate(_Fused(self._packed_detached), u, nowhere, mi.Normal3f(nowhere), active)
            dr.eval(sigma)
        return sigma

    def _evaluate(
        self, run: _Engine, u: Any, d: Any, n: Any, active: mi.Bool | bool = True
    ) -> tuple[mi.Float, mi.Color3f]:
        p = self.preset
        u = list(u)
        if p.deformation_layers:
            h = self._chain(run, "deform", len(p.deformation_layers), run.enter(frequency(u, p.deformation_octaves)))
            delta = run.rows(run.linear("deform_out", h))
            u = [a + p.deformation_scale * b for a, b in zip(u, delta, strict=True)]

        encoded = self._encode(u, active)
        h = run.enter(encoded)
        for i in range(len(p.density_layers)):
            if p.density_skip > 0 and i == p.density_skip:
                h = run.enter(encoded, h)
            h = run.relu(run.linear(f"density{i}", h))
        out = run.linear("density_out", h)
        if p.feature_width:
            head, h = run.head(out)
        else:
            head = run.rows(out)[0]
        sigma = self.activation(head)

        for i in range(len(p.colour_linear)):
            h = run.linear(f"linear{i}", h)
        seen: list[mi.Float] = []
        if p.direction_octaves >= 0:
            towards = dr.fma(-2.0 * dr.dot(d, n), mi.Vector3f(n), d) if p.direction == "mirrored" else d
            seen = frequency(list(towards), p.direction_octaves)
        if p.normal_octaves >= 0:
            seen += frequency(list(n), p.normal_octaves)
        h = run.enter(h, seen)
        h = self._chain(run, "colour", len(p.colour_layers), h)
        return sigma, self.colour(mi.Color3f(*run.rows(run.linear("colour_out", h))))

    def _encode(self, u: list[mi.Float], active: mi.Bool | bool) -> list[mi.Float]:
        if self._encoding is None:
            return frequency(u, self.preset.octaves)
        return self._encoding(self._grid, u, active)

    def activation(self, z: mi.Float) -> mi.Float:
        """σ in 1/m of the density network's output: the preset's activation, saturated. In [0, `density_limit`] for any z."""
        p = self.preset
        if p.density_activation == "softplus":
            a = softplus(z + p.density_bias)
        else:
            a = dr.maximum(z, 0)
        return saturated(a * p.density_gain, p.density_limit)

    @staticmethod
    def colour(c: mi.Color3f) -> mi.Color3f:
        """Linear colour of the colour network's output: its logistic is sRGB. In [0, 1] for any c."""
        return srgb_to_linear(dr.fma(dr.tanh(0.5 * c), 0.5, 0.5))

    @staticmethod
    def _chain(run: _Engine, name: str, count: int, h: Any) -> Any:
        for i in range(count):
            h = run.relu(run.linear(f"{name}{i}", h))
        return h


def _pack(tensors: dict[str, tuple[mi.TensorXf, mi.TensorXf]], half: bool = False) -> dict[str, tuple[Any, Any]]:
    """Matrices and biases as views of one packed array."""
    kind = mi.TensorXf16 if half else mi.TensorXf
    flat = [t if t.ndim == 2 and t.shape[1] > 1 else dr.ravel(t) for pair in tensors.values() for t in pair]
    views = nn.pack(*[kind(t) for t in flat], layout="training")
    return {name: (views[2 * i], views[2 * i + 1]) for i, name in enumerate(tensors)}


def _split(weights: mi.Float, layer: Layer) -> tuple[mi.TensorXf, mi.TensorXf, mi.TensorXf | None]:
    """A layer's matrix (outputs, inputs), bias (outputs, 1) and pose columns (outputs, pose), as attached gathers."""
    columns = layer.inputs + layer.pose

    def block(first: int, count: int) -> mi.TensorXf:
        index = dr.arange(mi.UInt32, layer.outputs * count)
        row = index // count
        return mi.TensorXf(dr.gather(mi.Float, weights, layer.offset + row * columns + first + (index - row * count)),
                           (layer.outputs, count))

    bias = dr.gather(mi.Float, weights, layer.offset + layer.outputs * columns + dr.arange(mi.UInt32, layer.outputs))
    return (block(0, layer.inputs), mi.TensorXf(bias, (layer.outputs, 1)),
            block(layer.inputs, layer.pose) if layer.pose else None)


def _products(weights: mi.Float, layer: Layer, features: mi.TensorXf) -> mi.TensorXf:
    """Σ_k f_k·W_k, what the pose features f (pose, 1) add to a layer's matrix (outputs, inputs)."""
    count = layer.outputs * layer.inputs
    index = layer.offset + layer.affine + dr.arange(mi.UInt32, layer.size - layer.affine)
    mixed = mi.TensorXf(dr.gather(mi.Float, weights, index), (count, layer.pose))
    return mi.TensorXf((mixed @ features).array, (layer.outputs, layer.inputs))


class _Engine(Protocol):
    """What the evaluation needs of a way to run layers: `enter` one with joined parts, apply it, ReLU, and take rows out again."""

    def enter(self, *parts: Any) -> Any: ...
    def linear(self, name: str, x: Any) -> Any: ...
    def relu(self, x: Any) -> Any: ...
    def rows(self, x: Any) -> list[mi.Float]: ...
    def head(self, x: Any) -> tuple[mi.Float, Any]: ...


class _Batched:
    """Tensors of shape (features, N)."""

    def __init__(self, tensors: dict[str, tuple[mi.TensorXf, mi.TensorXf]], width: int) -> None:
        self._tensors = tensors
        self._width = width

    def enter(self, *parts: Any) -> mi.TensorXf:
        """Joins rows, and a row of ones below them: with it a layer's bias is a column of its matrix, which costs the product next
        to nothing, where adding it to every row afterwards costs more than the product."""
        parts = (*parts, [dr.full(mi.Float, 1.0, self._width)])
        arrays: list[Any] = []
        rows = 0
        for part in parts:
            if isinstance(part, list):
                arrays += [p if dr.width(p) == self._width else p + dr.zeros(mi.Float, self._width) for p in part]
                rows += len(part)
            else:
                arrays.append(part.array)
                rows += part.shape[0]
        return mi.TensorXf(arrays[0] if len(arrays) == 1 else dr.concat(arrays), (rows, self._width))

    def linear(self, name: str, x: mi.TensorXf) -> mi.TensorXf:
        weight, bias = self._tensors[name]
        if x.shape[0] > weight.shape[1]:
            return dr.concat([weight, bias], axis=1) @ x
        return weight @ x + bias

    def relu(self, x: mi.TensorXf) -> mi.TensorXf:
        return dr.maximum(x, 0)

    def rows(self, x: mi.TensorXf) -> list[mi.Float]:
        index = dr.arange(mi.UInt32, self._width)
        return [dr.gather(mi.Float, x.array, index + row * self._width) for row in range(x.shape[0])]

    def head(self, x: mi.TensorXf) -> tuple[mi.Float, mi.TensorXf]:
        index = dr.arange(mi.UInt32, self._width)
        rest = dr.arange(mi.UInt32, (x.shape[0] - 1) * self._width) + self._width
        return (dr.gather(mi.Float, x.array, index),
                mi.TensorXf(dr.gather(mi.Float, x.array, rest), (x.shape[0] - 1, self._width)))


class _Fused:
    """Cooperative vectors, one a lane."""

    def __init__(self, views: dict[str, tuple[Any, Any]]) -> None:
        self._views = views
        self._kind = mi.Float

    def enter(self, *parts: Any) -> Any:
        return nn.CoopVec(*[self._kind(entry) for part in parts for entry in part])

    def linear(self, name: str, x: Any) -> Any:
        weight, bias = self._views[name]
        return nn.matvec(weight, x, bias)

    def relu(self, x: Any) -> Any:
        return dr.maximum(x, 0)

    def rows(self, x: Any) -> list[mi.Float]:
        return [mi.Float(entry) for entry in x]

    def head(self, x: Any) -> tuple[mi.Float, Any]:
        entries = list(x)
        return mi.Float(entries[0]), nn.CoopVec(*entries[1:])


class _Half(_Fused):
    """The same in half precision.

    Attributes:
        finite: whether every layer's output has been finite so far: what enters as infinity comes out as that or NaN.
    """

    def __init__(self, views: dict[str, tuple[Any, Any]]) -> None:
        super().__init__(views)
        self._kind = mi.Float16
        self.finite = mi.Bool(True)

    def linear(self, name: str, x: Any) -> Any:
        out = super().linear(name, x)
        for entry in out:
            self.finite = self.finite & dr.isfinite(mi.Float(entry))
        return out
