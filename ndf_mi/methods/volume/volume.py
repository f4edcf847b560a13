"""The contract of a volume: density and colour around a posed body, with parameters that training finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def stack_layers(sizes: Sequence[tuple[str, int, int]]) -> dict[str, Layer]:
    """Affine layers (name, inputs, outputs), one after the other in a flat vector, by name."""
    layers: dict[str, Layer] = {}
    offset = 0
    for name, inputs, outputs in sizes:
        layers[name] = Layer(name, inputs, 0, outputs, offset)
        offset += layers[name].size
    return layers


def layer_tensors(weights: mi.Float, layers: Mapping[str, Layer]
                  ) -> dict[str, tuple[mi.TensorXf, mi.TensorXf]]:
    """Matrix (outputs, inputs) and bias (outputs, 1) of each layer, attached to the flat vector: what the
    engines of `ndf_mi.field.engines` take.
    """
    return {name: matrices(weights, layer)[:2] for name, layer in layers.items()}
