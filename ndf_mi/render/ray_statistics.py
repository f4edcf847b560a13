"""Estimates the work of rendering a view from a few of its rays, for any samples and early termination."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.numerics import block_sum
from ndf_mi.render.image import Work
from ndf_mi.render.ray_samples import VolumeField, sample_rays
from ndf_mi.render.sampling import QUANTUM, box_interval, rounded
from ndf_mi.render.settings import Setting

#: Parts of a ray that statistics are kept for: the rounds of an image.
ROUNDS = 4
#: The probe takes this many samples per ray, times the field's own factor, at 1/SHRINK of the view's width
#: and height.
SAMPLES, SHRINK = 64, 4
#: Relative errors of the number of samples evaluated at once. Arrays grow by half at a time, so a few more
#: samples can take half as many lanes again: the expected number of lanes is a mean over these.
_RELATIVE_ERRORS = (0.97, 1.0, 1.03)


@dataclass(frozen=True)
class RayStatistics:
    """What the rays of a view meet, estimated from N of them in the order of their pixels.

    Attributes:
        rays: pixels whose ray meets the field's box.
        sample_factor: the field's factor on candidate samples.
        evaluated: (`ROUNDS`, N) fraction of the candidates that reach the networks, in each part of the ray's
            way through the box.
        before: (`ROUNDS`, N) transmittance in front of each part.
    """

    rays: int
    sample_factor: int
    evaluated: np.ndarray
    before: np.ndarray

    def counts(self, setting: Setting) -> Work:
        """The work of an image with one ray per pixel; candidates are not counted. Opaque rays drop out of
        later rounds, as in rendering.

        Raises:
            ValueError: the setting does not render rays in `ROUNDS` rounds.
        """
        rounds, count, tile = setting.renderer().tiling(self.sample_factor, self.rays)
        if rounds != ROUNDS:
            raise ValueError(f"{setting.samples} samples are rendered in {rounds} rounds, not in {ROUNDS}")
        candidates = count * self.sample_factor
        work = Work(rays=self.rays)
        for evaluated_fraction, before in zip(self.evaluated, self.before, strict=True):
            # `before` is 1 in the first round, so no ray drops out there.
            alive = before > setting.cutoff if setting.cutoff > 0 else np.ones(len(before), dtype=bool)
            rays = round(self.rays * alive.mean()) if len(alive) else 0
            if rays == 0:
                break
            # A tile is a run of consecutive live rays: differences of the cumulative sum give the samples of
            # each.
            ends = np.minimum(np.arange(math.ceil(rays / tile) + 1) * tile / rays, 1.0)
            fractions = np.concatenate([[0.0], np.cumsum(evaluated_fraction[alive])])
            cumulative = fractions / alive.sum() * rays * candidates
            per_tile = np.diff(np.interp(ends, np.linspace(0, 1, len(cumulative)), cumulative))
            work.tiles += len(per_tile)
            work.evaluated += float(per_tile.sum())
            launched = [sum(rounded(math.ceil(factor * samples), QUANTUM) for samples in per_tile)
                        for factor in _RELATIVE_ERRORS]
            work.launched += float(np.mean(launched))
        work.lanes = work.tiles * tile * candidates
        return work


def probe(volume: VolumeField, camera: Camera) -> RayStatistics:
    """Statistics of a view, from densities along one ray for every `SHRINK` × `SHRINK` pixels."""
    rays = Setting().renderer().met(volume, camera)
    small = camera.scaled(max(camera.w // SHRINK, 1), max(camera.h // SHRINK, 1))
    count = SAMPLES // ROUNDS
    y, x = np.divmod(np.arange(small.w * small.h), small.w)
    with dr.suspend_grad():
        every = small.rays(mi.Point2f(mi.Float(x), mi.Float(y)) + 0.5)
        met = np.flatnonzero(box_interval(volume.bbox, every)[0].numpy())
        if rays == 0 or not len(met):
            return RayStatistics(rays, volume.sample_factor, np.zeros((ROUNDS, 0)), np.ones((ROUNDS, 0)))
        chosen = np.full(rounded(len(met), QUANTUM), met[0])
        chosen[: len(met)] = met
        ray = small.rays(mi.Point2f(mi.Float(x[chosen]), mi.Float(y[chosen])) + 0.5)
        # Padding rays have no length.
        ray.maxt = mi.Float(np.where(np.arange(len(chosen)) < len(met), np.inf, 0.0))
        evaluated, before, transmittance = [], [], np.ones(len(met))
        for number in range(ROUNDS):
            samples = sample_rays(volume, ray, SAMPLES, window=(number * count, count))
            inside = block_sum(samples.spread(dr.full(mi.Float, 1.0, dr.width(samples.real))), samples.count)
            tau = block_sum(samples.optical_depth(), samples.count)
            dr.eval(inside, tau)
            evaluated.append(inside.numpy()[: len(met)] / samples.count)
            before.append(transmittance)
            transmittance = transmittance * np.exp(-tau.numpy()[: len(met)].astype(np.float64))
    return RayStatistics(rays, volume.sample_factor, np.stack(evaluated), np.stack(before))
