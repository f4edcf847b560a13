"""The neural field of NDF: pose features, deformation net, density and colour, on given coordinates.

It knows nothing of meshes, scenes or files. Its input is a point (u*, v*, l*) of the unit cube.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi import variants
from ndf_mi.colour import srgb_to_linear
from ndf_mi.field.encoding import GridEncoding, frequency
from ndf_mi.field.engines import Batched, Fused, Views, pack
from ndf_mi.field.layers import FieldParameters, initial_weights, layout, matrices, products
from ndf_mi.field.presets import Preset
from ndf_mi.numerics import saturated, softplus


class Field:
    """The networks of a preset: an architecture, without parameters.

    Attributes:
        preset: the architecture's options.
        joints: number J of the body's joints.
        pose_width: entries of the pose vector, 3·J.
        layers: the layers by name, and where each lies in the flat vector of weights.
    """

    def __init__(self, preset: Preset, joints: int) -> None:
        self.preset = preset
        self.joints = joints
        self.pose_width = 3 * joints
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
        grid = None if self.encoding is None else mi.Float(self.encoding.initial(rng))
        return FieldParameters(weights, grid)

    def bind(self, pose: mi.Float, parameters: FieldParameters) -> BoundField:
        """The field at one pose, (3·J) axis-angles of the joints relative to their parents, in radians, the
        root's zero. Pose features are computed and folded into biases and matrices once for all samples.
        Gradients flow to pose and parameters."""
        return BoundField(self, pose, parameters)


class BoundField:
    """A :class:`Field` with parameters at one pose. :meth:`batched` equals :meth:`fused`.

    Attributes:
        preset, majorant: the field's.
        width: of the widest layer that a sample passes through.
        half: whether :meth:`pack` has laid the weights out in half precision.
    """

    def __init__(self, field: Field, pose: mi.Float, parameters: FieldParameters) -> None:
        self.preset = field.preset
        self.majorant = field.majorant
        self.width = max(layer.outputs for name, layer in field.layers.items() if not name.startswith("pose"))
        self._encoding = field.encoding
        self._grid = parameters.grid
        self._views: Views | None = None
        self.half = False
        self._density_views: Views | None = None

        features = mi.TensorXf(pose, (field.pose_width, 1))
        for i in range(len(self.preset.pose_layers)):
            weight, bias, _ = matrices(parameters.weights, field.layers[f"pose{i}"])
            features = dr.maximum(weight @ features + bias, 0)
        self._tensors: dict[str, tuple[mi.TensorXf, mi.TensorXf]] = {}
        for name, layer in field.layers.items():
            if not name.startswith("pose"):
                weight, bias, pose_weight = matrices(parameters.weights, layer)
                if layer.products:
                    weight = weight + products(parameters.weights, layer, features)
                self._tensors[name] = (weight, bias if pose_weight is None else pose_weight @ features + bias)

    def batched(self, u: Sequence[mi.Float], d: mi.Vector3f, n: mi.Normal3f) -> tuple[mi.Float, mi.Color3f]:
        """Density and colour by dense matrix products over all samples, for evaluated code.

        Args:
            u: coordinates of N points in the unit cube, as many arrays as the preset's `dimension`; every
                lane finite.
            d: N unit view directions in world space.
            n: N unit normals of the body's surface in world space, for presets that use them.

        Returns:
            σ in 1/m, in [0, `density_limit`], and linear colour in [0, 1].
        """
        return self._evaluate(Batched(self._tensors, dr.width(d)), u, d, n)

    def fused(
        self, u: Sequence[mi.Float], d: mi.Vector3f, n: mi.Normal3f, active: mi.Bool | bool = True
    ) -> tuple[mi.Float, mi.Color3f]:
        """As :meth:`batched`, by cooperative vectors, which may also be traced in symbolic code such as a
        medium's.

        Needs :meth:`pack` beforehand, outside of symbolic code. σ is NaN where half precision has overflowed.
        """
        if self._views is None:
            raise RuntimeError("BoundField.fused: call pack() first, outside of symbolic code")
        run = Fused(self._views, self.half)
        sigma, colour = self._evaluate(run, u, d, n, active)
        return dr.select(run.finite, sigma, dr.nan) if self.half else sigma, colour

    def density(self, u: Sequence[mi.Float], active: mi.Bool) -> mi.Float:
        """σ alone as :meth:`batched` returns it in active lanes, detached, by the faster form; for evaluated
        code."""
        with dr.suspend_grad():
            # Neither direction nor normal enters the density.
            some = dr.full(mi.Vector3f, 1.0, dr.width(u[0]))
            if self.width > variants.fused_width():
                sigma, _ = self.batched(u, some, mi.Normal3f(some))
            else:
                if self._density_views is None:
                    detached = {name: dr.detach(pair) for name, pair in self._tensors.items()}
                    self._density_views = pack(detached)
                sigma, _ = self._evaluate(Fused(self._density_views), u, some, mi.Normal3f(some), active)
            dr.eval(sigma)
        return sigma

    def pack(self, half: bool | None = None) -> None:
        """Lays the weights out for :meth:`fused`; attached, so that gradients reach the parameters.

        Args:
            half: whether weights, features and sums of the layers are in half precision (11 bits from 6e-5 to
                65,504, fewer below). Encodings, the activations of density and colour, and results stay in
                single precision. None: only where the active variant supports nothing else.
        """
        if half is None:
            half = "single" not in variants.cooperative_precisions()
        self._views, self.half = pack(self._tensors, half), half

    @property
    def packed(self) -> bool:
        """Whether :meth:`pack` has been called."""
        return self._views is not None

    @property
    def attached(self) -> bool:
        """Whether gradients are tracked in any parameter or in the pose."""
        return dr.grad_enabled(list(self._tensors.values()), self._grid)

    def _evaluate(
        self, run: Batched | Fused, u: Sequence[mi.Float], d: mi.Vector3f, n: mi.Normal3f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Float, mi.Color3f]:
        p = self.preset
        u = list(u)
        if p.deformation_layers:  # ũ = u* + s·D(u*, θ)
            h = run.enter(frequency(u, p.deformation_octaves))
            h = _hidden(run, "deform", len(p.deformation_layers), h)
            delta = run.rows(run.linear("deform_out", h))
            u = [a + p.deformation_scale * b for a, b in zip(u, delta, strict=True)]

        encoded = frequency(u, p.octaves) if self._encoding is None else self._encoding(self._grid, u, active)
        h = run.enter(encoded)  # M_σ
        for i in range(len(p.density_layers)):
            if p.density_skip > 0 and i == p.density_skip:
                h = run.enter(encoded, h)
            h = dr.maximum(run.linear(f"density{i}", h), 0)
        out = run.linear("density_out", h)
        if p.feature_width:
            head, h = run.head(out)
        else:
            head = run.rows(out)[0]
        sigma = self.activation(head)

        for i in range(len(p.colour_linear)):  # M_c
            h = run.linear(f"linear{i}", h)
        seen: list[mi.Float] = []
        if p.direction_octaves >= 0:
            towards = dr.fma(-2.0 * dr.dot(d, n), mi.Vector3f(n), d) if p.direction == "mirrored" else d
            seen = frequency(list(towards), p.direction_octaves)
        if p.normal_octaves >= 0:
            seen += frequency(list(n), p.normal_octaves)
        h = _hidden(run, "colour", len(p.colour_layers), run.enter(h, seen))
        return sigma, self.colour(mi.Color3f(*run.rows(run.linear("colour_out", h))))

    def activation(self, z: mi.Float) -> mi.Float:
        """σ in 1/m from the density network's output: the preset's activation, saturated; in [0,
        `density_limit`] for any z."""
        p = self.preset
        a = softplus(z + p.density_bias) if p.density_activation == "softplus" else dr.maximum(z, 0)
        return saturated(a * p.density_gain, p.density_limit)

    @staticmethod
    def colour(c: mi.Color3f) -> mi.Color3f:
        """Linear colour from the colour network's output, whose logistic is sRGB; in [0, 1] for any c."""
        return srgb_to_linear(dr.fma(dr.tanh(0.5 * c), 0.5, 0.5))


def _hidden(run: Batched | Fused, name: str, count: int, h: Any) -> Any:
    """Applies hidden layers ``name0``, ``name1``, …"""
    for i in range(count):
        h = dr.maximum(run.linear(f"{name}{i}", h), 0)
    return h
