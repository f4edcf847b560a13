"""How a field is trained, apart from its architecture; every entry is an option of ``ndf-mi optimise``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from ndf_mi.body.box import BOX_PADDING
from ndf_mi.errors import InputError
from ndf_mi.options import read_options


@dataclass(frozen=True)
class TrainingOptions:
    """Schedule, sampling and loss."""

    steps: int = 6000
    """Steps in all. The learning rates' decay is spread over these."""

    seconds: float = 0.0
    """If above 0: the time to train for, in seconds. The decay then follows the clock, and `steps` is only a limit."""

    rays: int = 1024
    """Rays a step."""

    samples: int = 64
    """Candidate samples a ray."""

    atlas: str = "body"
    """Texture coordinates that the field lies over: `body`, the capture's own, or `one-piece`, the body cut open into a single chart."""

    skip_empty: bool = True
    """Leave out samples where the field has been found empty, but for a random eighth of them."""

    skip_hidden: float = 1e-3
    """Leave out samples that less than this share of the light gets to, past those before; 0 leaves none out."""

    mask_share: float = 0.5
    """Share of the rays that are drawn from the mask's pixels, the others from the body's padded box."""

    edge_kernel: int = 0
    """Pixels whose surroundings of this size hold both performer and background aren't drawn; 0 draws them all, the paper has 3."""

    box_padding: float = BOX_PADDING
    """Padding of the body's box in metres, for the pixels drawn."""

    learning_rate: float = 4e-3
    """Adam's rate for the networks."""

    grid_rate: float = 2e-2
    """Adam's rate for the hash table."""

    decay: float = 0.1
    """Factor that both rates reach over `decay_steps` steps, exponentially."""

    decay_steps: int = 0
    """Steps over which `decay` is reached; 0 for the whole training."""

    pose_noise: float = 0.1
    """Standard deviation, in radians, of noise on the joints' angles that the networks see, drawn anew each step: it keeps them from
    telling frames apart by their poses."""

    opacity_weight: float = 0.05
    """Weight of the mean squared difference of opacity and mask."""

    opacity_edge: int = 3
    """Pixels whose surroundings of this size hold both performer and background are left out of that term: the performer covers
    only part of them, which a mask doesn't say. 0 leaves none out."""

    edge_weight: float = 0.1
    """Weight of the mean density near the band's edge (|l| above 0.8 of it), in units of the preset's `density_gain`, once the
    image error is below `edge_below`."""

    edge_below: float = 0.005
    """Smoothed mean squared error of the image in sRGB below which the edge term counts."""

    clip: float = 40.0
    """Largest magnitude of an entry of the networks' gradient."""

    seed: int = 0
    """Of weights, rays and jitter."""

    checkpoint_seconds: float = 60.0
    """Time between checkpoints."""

    integrator: str = "ndf_quadrature"
    """What pixels are computed by: `ndf_quadrature` (emission and absorption) or `prbvolpath` (scattering, under the capture's light)."""

    warm_up: int = 1500
    """Steps by quadrature before those through scattering, which then start from its density; not with `ndf_quadrature`."""

    paths: int = 16
    """Paths a ray, at least 2; not with `ndf_quadrature`."""

    max_depth: int = 12
    """Longest path, as Mitsuba counts: 2 is single scattering; not with `ndf_quadrature`."""

    cell: float = 0.0125
    """Spacing in metres of the lattice that a field is put onto where paths scatter in it; not with `ndf_quadrature`."""

    def __post_init__(self) -> None:
        for key in ("steps", "rays", "samples", "learning_rate", "grid_rate", "decay", "clip", "checkpoint_seconds", "cell"):
            if not 0 < getattr(self, key) < float("inf"):
                raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), "a number above 0")
        for key in ("seconds", "pose_noise", "edge_kernel", "opacity_edge", "box_padding", "decay_steps", "opacity_weight", "edge_weight",
                    "edge_below", "seed", "skip_hidden", "warm_up"):
            if not 0 <= getattr(self, key) < float("inf"):
                raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), "a number from 0 on")
        if self.atlas not in ("body", "one-piece"):
            raise InputError("option atlas", repr(self.atlas), "body or one-piece")
        if not self.skip_hidden < 1:
            raise InputError("option skip-hidden", repr(self.skip_hidden), "a transmittance in [0, 1)")
        for key in ("paths", "max_depth"):
            if getattr(self, key) < 2:
                raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), "at least 2")
        if self.integrator != "ndf_quadrature" and self.warm_up >= self.steps:
            raise InputError("option warm-up", repr(self.warm_up), f"fewer than the {self.steps} steps in all")
        if not 0 <= self.mask_share <= 1:
            raise InputError("option mask-share", repr(self.mask_share), "a number in [0, 1]")

    def to_dict(self) -> dict[str, Any]:
        """The options as JSON-ready values."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any], where: str = "training") -> TrainingOptions:
        """The inverse of :meth:`to_dict`. Raises InputError for an option that does not exist."""
        # Trainings written down before there was noise on the pose were made without, and so on.
        return read_options(cls(), {"pose_noise": 0.0, "opacity_edge": 0, "skip_hidden": 0.0, **values}, where)

    @classmethod
    def paper(cls) -> TrainingOptions:
        """The published schedule and loss."""
        return cls(steps=200_000, edge_kernel=3, learning_rate=5e-4, decay_steps=500_000, opacity_weight=0.0,
                   skip_empty=False, skip_hidden=0.0, pose_noise=0.0)
