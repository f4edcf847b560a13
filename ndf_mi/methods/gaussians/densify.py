"""Which primitives training removes and which it splits, after 3D Gaussian splatting (Kerbl et al. 2023)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ndf_mi.methods.gaussians.primitives import Arrays, Binding

LEAST_OPACITY = 0.02
"""Primitives below this opacity are removed."""

SHRINK = 1.6
"""How many times smaller the halves of a split primitive are."""


@dataclass(frozen=True)
class Densified:
    """Primitives after a round.

    Attributes:
        binding: of M primitives.
        learned: theirs, (k, M) by name.
        split: how many were.
        removed: how many were.
    """

    binding: Binding
    learned: Arrays
    split: int
    removed: int


def densify(binding: Binding, learned: Arrays, score: np.ndarray, more: int, rng: np.random.Generator
            ) -> Densified:
    """Removes primitives that are hardly visible, and splits those of the largest scores.

    The halves of a primitive lie at opposite points drawn from its Gaussian, and share its place on the body.

    Args:
        learned: (k, N) by the names of `primitives.LEARNED`.
        score: (N,) from 0 on; what has 0 is not split.
        more: how many more to split than are removed, at most.
    """
    opacity = learned["logit_opacity"][0]
    # One stays, however little of it is seen: without any there is nothing to train.
    kept = np.flatnonzero(opacity >= min(-np.log(1 / LEAST_OPACITY - 1), opacity.max()))
    count = len(binding) - len(kept) + max(more, 0)
    order = kept[np.argsort(-score[kept], kind="stable")][:count]
    split = order[score[order] > 0]
    source = np.concatenate([kept, split])
    new = {name: values[:, source] for name, values in learned.items()}
    deviation = rng.normal(size=(3, len(split))) * np.exp(learned["log_scale"][:, split])
    aside = rotated(learned["rotation"][:, split], deviation).astype(np.float32)
    halves = np.searchsorted(kept, split), len(kept) + np.arange(len(split))
    for half, sign in zip(halves, (1, -1), strict=True):
        new["offset"][:, half] += sign * aside
        new["log_scale"][:, half] -= np.float32(np.log(SHRINK))
    return Densified(binding.select(source), new, len(split), len(binding) - len(kept))


def rotated(quaternions: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(3, N) vectors turned by (4, N) quaternions (x, y, z, w) of any length above 0."""
    axis, real = np.split(quaternions / np.linalg.norm(quaternions, axis=0), [3])
    twice = 2 * np.cross(axis, vectors, axis=0)
    return vectors + real * twice + np.cross(axis, twice, axis=0)
