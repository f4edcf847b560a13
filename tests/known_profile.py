"""A profile of a machine with known costs, for tests of the tuner."""

import numpy as np

from ndf_mi.render.cost import Sample
from ndf_mi.render.measure import CUTOFFS, Profile
from ndf_mi.render.ray_statistics import ROUNDS, RayStatistics
from ndf_mi.render.settings import Setting


def statistics(rays: int) -> RayStatistics:
    """A view in which a tenth of the candidates is evaluated and no ray ends early."""
    return RayStatistics(rays, 1, np.full((ROUNDS, 16), 0.1), np.ones((ROUNDS, 16)))


def known_profile(fixed: float = 0.05, each: float = 1e-6, error: float = 1.0) -> Profile:
    """A machine that takes `each` seconds for a sample evaluated, and an error that falls with the square of
    the samples."""
    samples = []
    for rays in (9000, 40000):
        for cutoff, factor in zip(CUTOFFS, (1.0, 1.5), strict=True):
            for n in (8, 40, 128):
                c = statistics(rays).counts(Setting(n, cutoff))
                seconds = fixed + each * c.evaluated
                samples.append(
                    Sample(
                        n, cutoff, c.tiles, c.lanes, c.evaluated, c.launched, seconds, factor * error / n**2)
                )
    return Profile(samples, 0.4)
