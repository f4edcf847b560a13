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
    """`total` to be minimised, attached; `image` the mean squared error in sRGB, and `box` that of the rays drawn from the body's box
    alone, NaN where there are none, None where it was not asked for; detached."""

    total: mi.Float
    image: mi.Float
    box: mi.Float | None = None


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

    def __call__(self, seen: Radiance, target: mi.Color3f, mask: mi.Float, sure: mi.Float,
                 in_box: mi.Float | None = None) -> Loss:
        """Loss of N rays against `target` (sRGB) and, where `sure` is 1 rather than 0, `mask` (1 on the performer); `in_box` is 1 for the
        rays drawn from the body's box, else 0."""
        colour = linear_to_srgb(seen.colour + (1.0 - seen.opacity) * self._background)
        error = dr.squared_norm(colour - target) / 3.0
        image, detached = dr.mean(error), dr.detach(error)
        box = None if in_box is None else dr.sum(dr.select(in_box > 0, detached, 0.0)) / dr.sum(in_box)
        return Loss(image + self.shape(seen, mask, sure), dr.detach(image), box)

    def shape(self, seen: Radiance, mask: mi.Float, sure: mi.Float) -> mi.Float:
        """The loss's terms in the density alone: opacity against `mask` where `sure` is 1, and density near the band's edge."""
        total = mi.Float(0.0)
        if self._options.opacity_weight > 0:
            total = total + self._options.opacity_weight * dr.mean(sure * dr.square(seen.opacity - mask))
        if self._options.edge_weight > 0:
            at_edge = seen.inside & (dr.abs(dr.detach(seen.samples.u.z)) > self._edge)
            count = dr.maximum(dr.sum(dr.select(at_edge, mi.Float(1), 0.0)), 1.0)
            density = dr.sum(dr.select(at_edge, seen.samples.sigma, 0.0)) / count
            total = total + (self._edge_scale * self._edge_on) * density
        return total

    def observe(self, image_error: float) -> None:
        """Turns the edge term on or off by a smoothed image error, as the paper does."""
        self._edge_on = dr.opaque(mi.Float, 1.0 if image_error < self._options.edge_below else 0.0)


class NoisyLoss:
    """Mean squared error of the mean of noisy estimates, without the bias that their variance puts on a square.

    The square of an estimate's error has the mean (E f − t)² + Var f, and a gradient to match: it would be made small by less noise, which
    thinner or darker media have. Here each estimate is multiplied with the others' mean error instead, which is independent of it:

        Σ_i (f_i − t)·(mean_{j≠i} f_j − t) / n,    whose mean is (E f − t)²

    The error is taken in sRGB to first order: linear, times the slope of the curve at the target. An error in sRGB would be no function
    of E f alone.
    """

    def __init__(self, samples: int) -> None:
        self._samples = samples

    def __call__(self, estimates: mi.Color3f, target: mi.Color3f) -> tuple[mi.Float, mi.Color3f]:
        """Loss and its derivatives in the estimates.

        Args:
            estimates: (N·samples) linear radiance, a ray's beside one another, detached.
            target: (N) sRGB.

        Returns:
            the error, one number, an estimate without bias that may be below 0; (N·samples) what to multiply the derivatives of the
            estimates with.
        """
        samples, width = self._samples, dr.width(estimates)
        parent = dr.arange(mi.UInt32, width) // samples
        linear = srgb_to_linear(target)
        slope = _slope(linear)
        error, adjoint = mi.Float(0.0), mi.Color3f()
        for channel in range(3):
            total = dr.block_sum(estimates[channel], samples)
            others = (dr.gather(mi.Float, total, parent) - estimates[channel]) / (samples - 1)
            aim, weight = dr.gather(mi.Float, linear[channel], parent), dr.square(dr.gather(mi.Float, slope[channel], parent))
            adjoint[channel] = 2.0 * weight * (others - aim) / (3 * width)
            error = error + 0.5 * dr.sum(adjoint[channel] * (estimates[channel] - aim))
        dr.eval(error, adjoint)
        return error, adjoint


def _slope(linear: mi.Color3f) -> mi.Color3f:
    """The derivative of the sRGB curve at linear values from 0 on."""
    return dr.select(linear <= 0.0031308, 12.92, (1.055 / 2.4) * dr.power(dr.maximum(linear, 0.0031308), 1 / 2.4 - 1))
