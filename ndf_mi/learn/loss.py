"""What training minimises."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.render.quadrature import Radiance


@dataclass
class Loss:
    """`total` to be minimised, attached; `image` the mean squared error in sRGB, detached."""

    total: mi.Float
    image: mi.Float


class ImageLoss:
    """Mean squared error in sRGB over the rays, plus what keeps opacity to the mask and density off the band's edge.

    Composited in linear light over the background: C = L + (1 − opacity)·B.
    """

    def __init__(self, options: TrainingOptions, background: mi.Color3f, band: float, density_gain: float) -> None:
        self._options = options
        self._background = srgb_to_linear(mi.Color3f(background))
        dr.make_opaque(self._background)
        self._edge = 0.8 * band
        self._edge_scale = options.edge_weight / density_gain
        self._edge_on = dr.opaque(mi.Float, 0.0)

    def __call__(self, seen: Radiance, target: mi.Color3f, mask: mi.Float, sure: mi.Float) -> Loss:
        """Loss of N rays against `target` (sRGB) and, where `sure` is 1 rather than 0, `mask` (1 on the performer)."""
        colour = linear_to_srgb(seen.colour + (1.0 - seen.opacity) * self._background)
        image = dr.mean(dr.squared_norm(colour - target)) / 3.0
        total = image
        if self._options.opacity_weight > 0:
            total = total + self._options.opacity_weight * dr.mean(sure * dr.square(seen.opacity - mask))
        if self._options.edge_weight > 0:
            at_edge = seen.inside & (dr.abs(dr.detach(seen.samples.u.z)) > self._edge)
            count = dr.maximum(dr.sum(dr.select(at_edge, mi.Float(1), 0.0)), 1.0)
            density = dr.sum(dr.select(at_edge, seen.samples.sigma, 0.0)) / count
            total = total + (self._edge_scale * self._edge_on) * density
        return Loss(total, dr.detach(image))

    def observe(self, image_error: float) -> None:
        """Turns the edge term on or off by a smoothed image error, as the paper does."""
        self._edge_on = dr.opaque(mi.Float, 1.0 if image_error < self._options.edge_below else 0.0)
