"""The training losses."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.render.quadrature import Radiance


@dataclass
class Loss:
    """One number each.

    Attributes:
        total: to be minimised; attached.
        image: mean squared error in sRGB, detached.
        box: the same over the rays drawn from the whole box; NaN without such rays, None where `in_box` was
            not given.
    """

    total: mi.Float
    image: mi.Float
    box: mi.Float | None = None


class ImageLoss:
    """Mean squared error in sRGB, plus terms that tie opacity to the mask and keep density off the band's
    edge.

    Colours are composited in linear light over the background B: C = L + (1 − opacity)·B.

    Args:
        options: `opacity_weight` and `edge_weight` are used.
        background: sRGB.
        band: the band's half width in metres; None where it varies.
        density_gain: of the preset; the unit of the edge term.
    """

    def __init__(self, options: TrainingOptions, background: mi.Color3f, band: float | None,
                 density_gain: float) -> None:
        self._opacity_weight = options.opacity_weight
        self._edge_weight = options.edge_weight / density_gain
        self._background = srgb_to_linear(mi.Color3f(background))
        dr.make_opaque(self._background)
        self._edge = None if band is None else 0.8 * band

    def __call__(self, radiance: Radiance, target: mi.Color3f, mask: mi.Float, mask_valid: mi.Float,
                 in_box: mi.Float | None = None, edge_active: bool = False) -> Loss:
        """The loss of N rays.

        Args:
            radiance: what the rays see.
            target: sRGB.
            mask: in [0, 1], the share of the pixel that the performer covers.
            mask_valid: in [0, 1], weights of the difference of opacity and mask.
            in_box: 1 for the rays drawn from the whole box, else 0.
            edge_active: whether the edge term counts.
        """
        error = self._errors(radiance, target)
        image, detached = dr.mean(error), dr.detach(error)
        box = None if in_box is None else dr.sum(dr.select(in_box > 0, detached, 0.0)) / dr.sum(in_box)
        return Loss(image + self.density_terms(radiance, mask, mask_valid, edge_active),
                    dr.detach(image), box)

    def image_error(self, radiance: Radiance, target: mi.Color3f) -> mi.Float:
        """The mean squared error in sRGB alone, one number."""
        return dr.mean(self._errors(radiance, target))

    def _errors(self, radiance: Radiance, target: mi.Color3f) -> mi.Float:
        colour = linear_to_srgb(radiance.colour + (1.0 - radiance.opacity) * self._background)
        return dr.squared_norm(colour - target) / 3.0

    def density_terms(self, radiance: Radiance, mask: mi.Float, mask_valid: mi.Float,
                      edge_active: bool) -> mi.Float:
        """The terms in the density alone: opacity against the mask, and density near the band's edge."""
        total = mi.Float(0.0)
        if self._opacity_weight > 0:
            total = total + self._opacity_weight * dr.mean(mask_valid * dr.square(radiance.opacity - mask))
        if self._edge_weight > 0:
            edge = 0.8 * radiance.samples.band if self._edge is None else self._edge
            at_edge = radiance.inside & (dr.abs(dr.detach(radiance.samples.u.z)) > edge)
            count = dr.maximum(dr.sum(dr.select(at_edge, mi.Float(1), 0.0)), 1.0)
            density = dr.sum(dr.select(at_edge, radiance.samples.sigma, 0.0)) / count
            # Opaque, so that switching the term on compiles nothing.
            total = total + (self._edge_weight * dr.opaque(mi.Float, float(edge_active))) * density
        return total


class NoisyLoss:
    """Mean squared error of the mean of noisy estimates, without the bias that their variance adds to a
    square.

    The square of an estimate's error has the mean (E f − t)² + Var f. Its gradient also reduces the variance,
    and thinner or darker media have less of it. Here each estimate's error is multiplied by the mean error of
    the others, which is independent of it:

        Σ_i (f_i − t)·(mean_{j≠i} f_j − t) / n,    whose mean is (E f − t)²

    The error is taken in sRGB to first order: the linear error times the slope of the sRGB curve at the
    target. The error in sRGB itself would not be a function of E f alone.

    Args:
        samples: estimates a ray, at least 2.
    """

    def __init__(self, samples: int) -> None:
        self._samples = samples

    def __call__(self, estimates: mi.Color3f, target: mi.Color3f) -> tuple[mi.Float, mi.Color3f]:
        """Loss and its derivatives in the estimates.

        Args:
            estimates: (N·samples) linear radiance, ray by ray, detached.
            target: (N) sRGB.

        Returns:
            the loss, one number, an unbiased estimate that can be below 0; and its (N·samples) derivatives
            in the estimates.
        """
        samples, width = self._samples, dr.width(estimates)
        parent = dr.arange(mi.UInt32, width) // samples
        linear = srgb_to_linear(target)
        slope = _slope(linear)
        error, adjoint = mi.Float(0.0), mi.Color3f()
        for channel in range(3):
            total = dr.block_sum(estimates[channel], samples)
            others = (dr.gather(mi.Float, total, parent) - estimates[channel]) / (samples - 1)
            aim = dr.gather(mi.Float, linear[channel], parent)
            weight = dr.square(dr.gather(mi.Float, slope[channel], parent))
            adjoint[channel] = 2.0 * weight * (others - aim) / (3 * width)
            error = error + 0.5 * dr.sum(adjoint[channel] * (estimates[channel] - aim))
        dr.eval(error, adjoint)
        return error, adjoint


def _slope(linear: mi.Color3f) -> mi.Color3f:
    """The derivative of the sRGB curve at linear values from 0 on."""
    return dr.select(linear <= 0.0031308, 12.92,
                     (1.055 / 2.4) * dr.power(dr.maximum(linear, 0.0031308), 1 / 2.4 - 1))
