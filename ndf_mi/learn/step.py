"""A training step by quadrature as a function: ``loss, statistics = step(parameters, batch)``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi

from ndf_mi.field import FieldParameters
from ndf_mi.field.occupancy import Occupancy
from ndf_mi.learn.batch import Batch
from ndf_mi.learn.corrections import NONE, Corrections
from ndf_mi.learn.loss import ImageLoss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.refinement import Refinement
from ndf_mi.model import PosedModel
from ndf_mi.render.quadrature import Radiance, quadrature
from ndf_mi.run import Run


@dataclass(frozen=True)
class Statistics:
    """What a step reports besides its loss; detached.

    Attributes:
        error: mean squared error in sRGB of the rays, one number.
        box_error: the same over the rays drawn from the whole box, or None.
        evaluated: number of samples that reached the networks.
        places, densities, valid: where these samples lie in the unit cube of (u, v, l), their σ in 1/m, and
            which lanes are samples rather than padding: what the occupancy grid observes.
    """

    error: mi.Float
    box_error: mi.Float | None
    evaluated: int
    places: mi.Point3f
    densities: mi.Float
    valid: mi.Bool


class Step(Protocol):
    """A training step. It keeps no state between calls."""

    def __call__(self, parameters: FieldParameters, batch: Batch, corrections: Corrections = NONE
                 ) -> tuple[mi.Float, Statistics]:
        """The loss, one number attached to `parameters` and `corrections`, and statistics."""
        ...


class QuadratureStep:
    """Emission and absorption by quadrature along the batch's rays.

    Args:
        run: the body and the networks' architecture; its parameters are not used.
        options: sampling and loss.
        occupancy: says which cells to skip; read, never changed. None skips none.
        refinement: what corrections mean; without it there must be none.
    """

    def __init__(self, run: Run, options: TrainingOptions, occupancy: Occupancy | None,
                 refinement: Refinement | None = None) -> None:
        preset = run.model.field.preset
        self._run = run
        self._options = options
        self._occupancy = occupancy
        self._refinement = refinement
        self._loss = ImageLoss(options, mi.Color3f(*(float(v) for v in run.background)),
                               preset.band if run.model.bands is None else None, preset.density_gain)

    def __call__(self, parameters: FieldParameters, batch: Batch, corrections: Corrections = NONE
                 ) -> tuple[mi.Float, Statistics]:
        radiance, posed = self._radiance(parameters, batch, corrections)
        loss = self._loss(radiance, mi.Color3f(batch.target), mi.Float(batch.mask),
                          mi.Float(batch.mask_valid), mi.Float(batch.in_box), batch.edge_active)
        total = loss.total
        if self._refinement is not None and corrections.groups():
            total = total + self._refinement.penalty(corrections)
        return total, statistics(radiance, posed, loss.image, loss.box)

    def image_error(self, parameters: FieldParameters, batch: Batch, corrections: Corrections = NONE
                    ) -> float:
        """Mean squared error in sRGB of the batch's rays, rendered as in images: no sample is skipped."""
        with dr.suspend_grad():
            radiance, _ = self._radiance(parameters, batch, corrections.detached(), as_image=True)
            return float(self._loss.image_error(radiance, mi.Color3f(batch.target))[0])

    def density_terms(self, parameters: FieldParameters, batch: Batch
                      ) -> tuple[mi.Float, Radiance, PosedModel]:
        """The loss's terms in the density alone, one number, and what they were computed from."""
        radiance, posed = self._radiance(parameters, batch, NONE)
        mask, mask_valid = mi.Float(batch.mask), mi.Float(batch.mask_valid)
        return self._loss.density_terms(radiance, mask, mask_valid, batch.edge_active), radiance, posed

    def _radiance(self, parameters: FieldParameters, batch: Batch, corrections: Corrections,
                  as_image: bool = False) -> tuple[Radiance, PosedModel]:
        """What the batch's rays see, and of what.

        Args:
            as_image: whether no sample is skipped.
        """
        run, options, refinement = self._run, self._options, self._refinement
        if refinement is None or not corrections.groups():
            surface, pose, ray = run.surface(batch.frame), mi.Float(batch.pose), batch.ray
        else:
            fitted = refinement.fitted(corrections, batch)
            surface, pose, ray = fitted.surface, fitted.pose, fitted.ray
        posed = PosedModel(run.model, parameters, surface, pose, None if as_image else self._occupancy)
        radiance = quadrature(posed, ray, options.samples, jitter=mi.Float(batch.jitter),
                              min_transmittance=0.0 if as_image else options.min_transmittance)
        if refinement is not None and refinement.colours is not None and corrections.colours is not None:
            radiance.colour = refinement.colours.seen(corrections.colours, mi.UInt32(batch.camera),
                                                      radiance.colour, radiance.opacity)
        return radiance, posed


def statistics(radiance: Radiance, posed: PosedModel, error: mi.Float,
               box_error: mi.Float | None = None) -> Statistics:
    """The statistics of a step whose rays see `radiance` of `posed`."""
    u, sigma = dr.detach(radiance.samples.u), dr.detach(radiance.samples.sigma)
    places = posed.unit(mi.Point2f(u.x, u.y), u.z)
    return Statistics(error, box_error, radiance.evaluated, places, sigma, radiance.inside)
