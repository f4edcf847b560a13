"""The networks: corrections of blend weights, and the canonical NeRF; and tables of latent codes.

A frame's latent code is the same for all of its samples. Its columns of a layer's matrix are folded into the
bias, once a frame.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi import variants
from ndf_mi.field import Field
from ndf_mi.field.encoding import frequency, frequency_width
from ndf_mi.field.engines import Batched, Fused, Views, pack
from ndf_mi.field.layers import initial_weights, layout
from ndf_mi.methods.animatable_nerf.architecture import Architecture
from ndf_mi.methods.volume.volume import layer_tensors, stack_layers


class Codes:
    """A table of latent codes in a flat vector.

    Args:
        count: number of codes.
        width: of a code.
    """

    def __init__(self, count: int, width: int) -> None:
        self.count = count
        self.width = width

    def initial(self, rng: np.random.Generator) -> np.ndarray:
        """Standard normal numbers, which PyTorch's embeddings begin with."""
        return rng.standard_normal(self.count * self.width).astype(np.float32)

    def __call__(self, table: mi.Float, row: int) -> mi.Float:
        """One code, attached to the table."""
        index = dr.arange(mi.UInt32, self.width) + dr.opaque(mi.UInt32, row * self.width)
        return dr.gather(mi.Float, table, index)


class CanonicalField(Field):
    """Density and colour around the body at rest: a :class:`Field` whose `bind` takes a frame's latent code
    in place of a pose. The code joins at the second linear layer of the colours, or at their first layer
    where there is no linear one.
    """

    def __init__(self, shape: Architecture) -> None:
        super().__init__(shape.canonical, 0)
        self.pose_width = shape.colour_latent
        joined = "linear1" if shape.canonical.colour_linear else "colour0"
        sizes = [(layer.name, layer.inputs, layer.outputs) for layer in layout(shape.canonical, 0).values()]
        self.layers = stack_layers(sizes, {joined: shape.colour_latent})


class BlendNetwork:
    """Δ(x, code): what is added to the logarithms of the body's blend weights, one number a joint.

    Attributes:
        layers: by name, and where each lies in the flat vector of weights.
        size: number of weights.
        width: of the widest layer.
        octaves: of the point's encoding.
        skip: the hidden layer at which the input is joined again, or 0.
        joined: names of the layers that the code enters.
    """

    def __init__(self, shape: Architecture, joints: int) -> None:
        self.octaves, self.skip = shape.blend_octaves, shape.blend_skip
        encoded = frequency_width(3, shape.blend_octaves)
        sizes, width = [], 0
        for i, outputs in enumerate(shape.blend_layers):
            sizes.append((f"blend{i}", width + (encoded if i in (0, self.skip) else 0), outputs))
            width = outputs
        self.joined = {f"blend{i}" for i in (0, self.skip)}
        self.layers = stack_layers([*sizes, ("blend_out", width, joints)],
                                   dict.fromkeys(self.joined, shape.blend_latent))
        self.size = sum(layer.size for layer in self.layers.values())
        self.width = max(*shape.blend_layers, joints)

    def initial(self, rng: np.random.Generator) -> np.ndarray:
        """Untrained weights."""
        return initial_weights(self.layers, rng)

    def bind(self, code: mi.Float, weights: mi.Float) -> BoundBlend:
        """The network with a frame's code; gradients flow to both."""
        return BoundBlend(self, code, weights)


class BoundBlend:
    """A :class:`BlendNetwork` with weights and a code."""

    def __init__(self, network: BlendNetwork, code: mi.Float, weights: mi.Float) -> None:
        self._network = network
        self._tensors = layer_tensors(weights, network.layers, dict.fromkeys(network.joined, code))
        self._views: Views | None = None

    @property
    def attached(self) -> bool:
        """Whether gradients are tracked in weights or code."""
        return dr.grad_enabled(list(self._tensors.values()))

    def __call__(self, x: mi.Point3f) -> mi.TensorXf:
        """Δ at N points in metres, finite in every lane: (J, N). By matrix products, or where nothing is
        differentiated and the layers are narrow, by cooperative vectors.
        """
        count = dr.width(x)
        wide = self._network.width > variants.fused_width()
        if wide or self.attached or dr.grad_enabled(x):
            return self._evaluate(Batched(self._tensors, count), x)
        if self._views is None:
            self._views = pack({name: dr.detach(pair) for name, pair in self._tensors.items()})
        rows = list(self._evaluate(Fused(self._views), x))
        return mi.TensorXf(dr.concat([mi.Float(row) for row in rows]), (len(rows), count))

    def _evaluate(self, run: Batched | Fused, x: mi.Point3f) -> Any:
        encoded = frequency(list(x), self._network.octaves)
        h = run.enter(encoded)
        for i in range(len(self._tensors) - 1):
            if i > 0 and i == self._network.skip:
                h = run.enter(encoded, h)
            h = dr.maximum(run.linear(f"blend{i}", h), 0)
        return run.linear("blend_out", h)
