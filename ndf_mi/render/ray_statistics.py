"""What a picture of a view will ask of the machine, counted on few of its rays: for any number of samples and any early termination."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.numerics import block_sum
from ndf_mi.render.ray_samples import VolumeField, sample_rays
from ndf_mi.render.sampling import QUANTUM, box_interval, rounded
from ndf_mi.render.settings import Setting

#: Parts that rays are looked at in: a picture's rounds.
ROUNDS = 4
#: A view is looked at with so many samples a ray, times the field's own factor, on so small a share of its width and height.
SAMPLES, SHRINK = 64, 4
#: How far the number of samples evaluated at once may be off what is believed: arrays of a steady size hold them, so that a few more can
#: take half as many lanes again.
_OFF = (0.97, 1.0, 1.03)


@dataclass(frozen=True)
class Counts:
    """What one ray a pixel takes, as :class:`ndf_mi.render.image.Work` counts it."""

    tiles: int
    lanes: int
    evaluated: float
    launched: float


@dataclass(frozen=True)
class Sight:
    """A view of a field, and what some of its rays meet in each part of their length.

    Attributes:
        rays: of all pixels, that meet the field's box.
        strata: the field's factor on candidate samples.
        evaluated: (`ROUNDS`, N) of N rays, by their pixels' order, in each part of their way through the box, the share of the candidates
            that reach the networks.
        before: (`ROUNDS`, N) transmittance in front of each part.
    """

    rays: int
    strata: int
    evaluated: np.ndarray
    before: np.ndarray

    def counts(self, setting: Setting) -> Counts:
        """Of a picture, rays a pixel apart. What is opaque is left out of the rounds behind, as a picture leaves it out.

        Raises:
            ValueError: its rays are not looked at in `ROUNDS` rounds.
        """
        rounds, count, tile = setting.renderer().tiling(self.strata, self.rays)
        if rounds != ROUNDS:
            raise ValueError(f"{setting.samples} samples are looked at in {rounds} rounds, not in {ROUNDS}")
        tiles, evaluated, launched = 0, 0.0, 0.0
        for number in range(ROUNDS):
            alive = self.before[number] > setting.cutoff if number and setting.cutoff > 0 else np.ones(len(self.before[number]), dtype=bool)
            rays = round(self.rays * alive.mean()) if len(alive) else 0
            if rays == 0:
                break
            # Tiles are runs of the rays left: what is in each of them follows from the sum up to its ends.
            ends = np.minimum(np.arange(math.ceil(rays / tile) + 1) * tile / rays, 1.0)
            summed = np.concatenate([[0.0], np.cumsum(self.evaluated[number][alive])]) / alive.sum() * rays * count * self.strata
            each = np.diff(np.interp(ends, np.linspace(0, 1, len(summed)), summed))
            tiles += len(each)
            evaluated += float(each.sum())
            launched += float(np.mean([sum(rounded(math.ceil(off * one), QUANTUM) for one in each) for off in _OFF]))
        return Counts(tiles, tiles * tile * count * self.strata, evaluated, launched)


def look(volume: VolumeField, camera: Camera) -> Sight:
    """Looks at a view: densities along one ray of each of `SHRINK` times `SHRINK` pixels."""
    rays = Setting().renderer().met(volume, camera)
    small = camera.scaled(max(camera.w // SHRINK, 1), max(camera.h // SHRINK, 1))
    count = SAMPLES // ROUNDS
    y, x = np.divmod(np.arange(small.w * small.h), small.w)
    with dr.suspend_grad():
        met = np.flatnonzero(box_interval(volume.bbox, small.rays(mi.Point2f(mi.Float(x), mi.Float(y)) + 0.5))[0].numpy())
        if rays == 0 or not len(met):
            return Sight(rays, volume.sample_factor, np.zeros((ROUNDS, 0)), np.ones((ROUNDS, 0)))
        # The padding's rays end where they start.
        chosen = np.full(rounded(len(met), QUANTUM), met[0])
        chosen[: len(met)] = met
        ray = small.rays(mi.Point2f(mi.Float(x[chosen]), mi.Float(y[chosen])) + 0.5)
        ray.maxt = mi.Float(np.where(np.arange(len(chosen)) < len(met), np.inf, 0.0))
        shares, before, transmittance = [], [], np.ones(len(met))
        for number in range(ROUNDS):
            strata = sample_rays(volume, ray, SAMPLES, window=(number * count, count))
            inside = block_sum(strata.spread(dr.full(mi.Float, 1.0, dr.width(strata.real))), strata.count)
            tau = block_sum(strata.optical_depth(), strata.count)
            dr.eval(inside, tau)
            shares.append(inside.numpy()[: len(met)] / strata.count)
            before.append(transmittance)
            transmittance = transmittance * np.exp(-tau.numpy()[: len(met)].astype(np.float64))
    return Sight(rays, volume.sample_factor, np.stack(shares), np.stack(before))
