"""The loss of a volume on rays of the training images."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.learn.batch import BatchSampler
from ndf_mi.learn.loss import ImageLoss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.methods.volume.optimisation import Outcome
from ndf_mi.methods.volume.volume import Parameters, Volume
from ndf_mi.render.quadrature import quadrature


@dataclass(frozen=True)
class RaySettings:
    """How rays are drawn and what their loss is; each as in `TrainingOptions`.

    Attributes:
        rays: a step, all of one frame, from all its cameras.
        samples: candidate samples a ray.
        mask_share: share of the rays from the mask's pixels; the others come from the body's padded box.
        edge_kernel: pixels on the mask's edge that are skipped.
        min_transmittance: samples that less light reaches are skipped.
        opacity_weight: weight of the mean squared difference of opacity and mask.
    """

    rays: int = 1024
    samples: int = 64
    mask_share: float = 0.5
    edge_kernel: int = 0
    min_transmittance: float = 0.0
    opacity_weight: float = 0.0


class RayObjective:
    """Mean squared error in sRGB of rays of the training split, with the mask's and the volume's own terms.

    All images are held in memory.

    Args:
        capture: the images.
        volume: what is trained.
        settings: of rays and loss.

    Raises:
        InputError: the capture cannot be trained on.
    """

    def __init__(self, capture: Capture, volume: Volume, settings: RaySettings) -> None:
        options = TrainingOptions(
            rays=settings.rays, samples=settings.samples, mask_share=settings.mask_share,
            edge_kernel=settings.edge_kernel, min_transmittance=settings.min_transmittance,
            opacity_weight=settings.opacity_weight, edge_weight=0.0, pose_noise=0.0)
        self._volume, self._settings = volume, settings
        self._batches = BatchSampler(capture, options, 1, volume.poses)
        self._loss = ImageLoss(options, mi.Color3f(*map(float, capture.background)), None, 1.0)

    def __call__(self, parameters: Parameters, rng: np.random.Generator) -> Outcome:
        """The loss of one batch."""
        batch, settings = self._batches(rng), self._settings
        posed = self._volume.at(batch.frame, parameters)
        radiance = quadrature(posed, batch.ray, settings.samples, jitter=mi.Float(batch.jitter),
                              min_transmittance=settings.min_transmittance)
        loss = self._loss(radiance, mi.Color3f(batch.target), mi.Float(batch.mask),
                          mi.Float(batch.mask_valid))
        penalty = posed.penalty(radiance)
        total = loss.total if penalty is None else loss.total + penalty
        return Outcome(total, dr.detach(loss.image))
