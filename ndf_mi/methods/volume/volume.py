"""The contract of a volume: density and colour around a posed body, with parameters that training finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Protocol, TypeAlias

import mitsuba as mi
import numpy as np

from ndf_mi.body.poses import Poses
from ndf_mi.field.layers import Layer, matrices
from ndf_mi.render.quadrature import Radiance
from ndf_mi.render.ray_samples import VolumeField

Parameters: TypeAlias = "Mapping[str, mi.Float]"
"""Flat tensors by name."""


class PosedVolume(VolumeField, Protocol):
    """A volume at one frame: what quadrature renders.

    Where a volume has no surface, `locate` returns `Located.anywhere`.
    """

    def penalty(self, radiance: Radiance) -> mi.Float | None:
        """A term that training adds to the loss of rays that see `radiance`: one number attached to the
        parameters, or None. `radiance.samples` is what `evaluate` returned, which may be a subclass of
        `FieldSample` with more members.
        """
        ...


class Volume(Protocol):
    """An architecture for the performer of one capture, without parameters.

    Attributes:
        poses: those of the surface that it is built on. Training draws pixels around it.
        rates: a factor on the learning rate for each parameter that has one other than 1.
    """

    poses: Poses
    rates: Mapping[str, float]

    def initial(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Flat float32 tensors to start training from, by name."""
        ...

    def at(self, frame: int, parameters: Parameters) -> PosedVolume:
        """The volume at a frame, attached to the parameters. What depends on the pose alone may be kept for
        the next call, within a bound on memory.

        Raises:
            InputError: there is no such frame.
        """
        ...


def stack_layers(sizes: Sequence[tuple[str, int, int]], shared: Mapping[str, int] = MappingProxyType({})
                 ) -> dict[str, Layer]:
    """Affine layers, one after the other in a flat vector, by name. `initial_weights` fills it.

    Args:
        sizes: name, inputs that change with the sample, and outputs of each.
        shared: number of inputs that are the same for all samples, such as a latent code, by layer.
    """
    layers: dict[str, Layer] = {}
    offset = 0
    for name, inputs, outputs in sizes:
        layers[name] = Layer(name, inputs, shared.get(name, 0), outputs, offset)
        offset += layers[name].size
    return layers


def layer_tensors(weights: mi.Float, layers: Mapping[str, Layer],
                  shared: Mapping[str, mi.Float] = MappingProxyType({})
                  ) -> dict[str, tuple[mi.TensorXf, mi.TensorXf]]:
    """Matrix (outputs, inputs) and bias (outputs, 1) of each layer, attached: what the engines of
    `ndf_mi.field.engines` take.

    Args:
        weights: the flat vector.
        shared: the inputs that are the same for all samples, by layer; their products become a part of the
            bias.
    """
    found = {}
    for name, layer in layers.items():
        matrix, bias, columns = matrices(weights, layer)
        if columns is not None:
            bias = bias + columns @ mi.TensorXf(shared[name], (layer.pose, 1))
        found[name] = matrix, bias
    return found
