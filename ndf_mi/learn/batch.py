"""What a training step takes besides the parameters: rays and all random numbers, drawn in a fixed order."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ndf_mi.body.poses import Poses
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.rays import RayBatch, RaySampler


@dataclass(frozen=True)
class PathSeeds:
    """Random numbers of a step through scattering.

    Attributes:
        shift: (3,) in [0, 1): the grid's offset in cells.
        seed: of the paths.
    """

    shift: np.ndarray
    seed: int


@dataclass(frozen=True)
class Batch:
    """The input of one step.

    Attributes:
        rays: R rays of one frame with their targets.
        jitter: flat float32 in [0, 1), a number for each candidate sample of each ray, ray by ray.
        pose: flat (3·J,) float32 axis-angles that the networks see, with noise.
        edge_active: whether the loss's term at the band's edge counts.
        paths: only for steps through scattering.
    """

    rays: RayBatch
    jitter: np.ndarray
    pose: np.ndarray
    edge_active: bool
    paths: PathSeeds | None = None

    @property
    def ray(self) -> mi.Ray3f:
        """The rays as Mitsuba's."""
        return mi.Ray3f(mi.Point3f(self.rays.origin), mi.Vector3f(self.rays.direction))


class BatchSampler:
    """Draws batches.

    Args:
        rays: draws the rays.
        poses: of the run.
        options: `rays`, `samples` and `pose_noise` are used.
        sample_factor: of the preset.
    """

    def __init__(self, rays: RaySampler, poses: Poses, options: TrainingOptions, sample_factor: int) -> None:
        self._rays = rays
        self._poses = poses
        self._pose_noise = options.pose_noise
        self._candidates = options.rays * options.samples * sample_factor

    def __call__(self, rng: np.random.Generator, edge_active: bool, scattering: bool) -> Batch:
        """A random batch; for a step through scattering with the seeds of its paths."""
        rays = self._rays(rng)
        jitter = rng.random(self._candidates, dtype=np.float32)
        pose = self._poses.pose[self._poses.index(rays.frame)].astype(np.float32)
        if self._pose_noise > 0:
            # All joints but the root, whose rotation is not part of the pose vector.
            pose[1:] += rng.normal(0.0, self._pose_noise, pose[1:].shape).astype(np.float32)
        paths = PathSeeds(rng.random(3), int(rng.integers(2**32))) if scattering else None
        return Batch(rays, jitter, pose.ravel(), edge_active, paths)
