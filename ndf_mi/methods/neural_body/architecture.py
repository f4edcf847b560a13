"""Sizes of Neural Body: as published, and those that learn in minutes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import drjit as dr
import mitsuba as mi

from ndf_mi.field.encoding import frequency_width
from ndf_mi.field.layers import Layer
from ndf_mi.methods.volume.volume import stack_layers
from ndf_mi.numerics import saturated, softplus


@dataclass(frozen=True)
class Architecture:
    """Sizes and activations. The defaults are the published ones.

    Attributes:
        voxel: edge of the finest voxels in metres.
        padding: by which the body's box grows on every side, in metres.
        code: length of a vertex's code.
        code_rate: factor on the codes' learning rate.
        channels: features at strides 1, 2, 4, …
        depths: submanifold convolutions at each stride, after the strided one that leads to it.
        density_layers: widths of the hidden layers of the density network; the last is that of the linear
            layers that follow for the colour too.
        latent: length of a frame's latent code.
        colour_width: of the colour network's hidden layer.
        position_octaves, direction_octaves: of the frequency encodings of the point in world space and of the
            view direction, which join there; −1 leaves one out.
        reach: the volume is empty where this stride has no voxel around: 1, 2, … for stride 2, 4, …; 0 for a
            volume that fills the box.
        cover: share of the training masks' pixels whose rays must pass the volume. Where they don't, it
            reaches as far as the first stride with which they do. 0 asks for nothing.
        activation, gain, bias, limit: of the density, as `density_activation` and so on of NDF's presets.
    """

    voxel: float = 0.005
    padding: float = 0.05
    code: int = 16
    code_rate: float = 1.0
    channels: tuple[int, ...] = (16, 32, 64, 128, 128)
    depths: tuple[int, ...] = (2, 2, 3, 3, 3)
    density_layers: tuple[int, ...] = (256, 256, 256)
    latent: int = 128
    colour_width: int = 128
    position_octaves: int = 10
    direction_octaves: int = 4
    reach: int = 0
    cover: float = 0.0
    activation: Literal["relu", "softplus"] = "relu"
    gain: float = 1.0
    bias: float = 0.0
    limit: float = 10_000.0

    @property
    def features(self) -> int:
        """Features of a point: those of all strides but the first."""
        return sum(self.channels[1:])

    @property
    def convolutions(self) -> list[tuple[int, int, int, bool]]:
        """All convolutions in order: index of the stride, channels in and out, and whether it leads there
        from the stride before.
        """
        found, width = [], self.code
        for stride, (channels, depth) in enumerate(zip(self.channels, self.depths, strict=True)):
            for number in range(depth + (stride > 0)):
                found.append((stride, width, channels, stride > 0 and number == 0))
                width = channels
        return found

    def layers(self) -> dict[str, Layer]:
        """The networks' layers; the latent code is an input of `linear1`."""
        sizes, width = [], self.features
        for number, hidden in enumerate(self.density_layers):
            sizes.append((f"density{number}", width, hidden))
            width = hidden
        encoded = sum(frequency_width(3, octaves)
                      for octaves in (self.direction_octaves, self.position_octaves) if octaves >= 0)
        sizes += [("density_out", width, 1), ("linear0", width, width), ("linear1", width, width),
                  ("colour0", width + encoded, self.colour_width), ("colour_out", self.colour_width, 3)]
        return stack_layers(sizes, {"linear1": self.latent})

    def density(self, z: mi.Float) -> mi.Float:
        """σ in 1/m, in [0, `limit`], from the density network's output."""
        a = softplus(z + self.bias) if self.activation == "softplus" else dr.maximum(z, 0)
        return saturated(a * self.gain, self.limit)
