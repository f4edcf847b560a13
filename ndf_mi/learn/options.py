"""Training options apart from the architecture. Each is an option of ``ndf-mi optimise``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from ndf_mi.body.box import BOX_PADDING
from ndf_mi.deprecated import TRAINING_FIELDS, rename_entries
from ndf_mi.errors import InputError
from ndf_mi.options import read_options
from ndf_mi.run import QUADRATURE

REFINABLE = ("pose", "shape", "cameras")
"""What `TrainingOptions.refine` can name."""


@dataclass(frozen=True)
class TrainingOptions:
    """Schedule, sampling and loss.

    Raises:
        InputError: a value is out of range.
    """

    steps: int = 6000
    """Number of steps. The learning rates decay over these."""

    seconds: float = 0.0
    """If above 0: training time in seconds. The rates decay with the clock; `steps` is an upper limit."""

    rays: int = 1024
    """Rays a step."""

    samples: int = 64
    """Candidate samples a ray."""

    atlas: str = "body"
    """Texture coordinates: `body` for the capture's own, `one-piece` for the body cut into one chart."""

    surface: Literal["body", "offset"] = "offset"
    """The reference surface: `offset`, the body with static offsets that are fitted to the training images
    first, so that clothes and hair come within reach of a thin band; or `body`, the body alone, as in the
    paper."""

    bands: Literal["uniform", "local"] = "uniform"
    """With a plan: all places have the band that the widest needs, or each has its own, which is quicker and
    can be less accurate where masks say little."""

    skip_empty: bool = True
    """Skip samples in cells that have been empty so far, except for a random eighth of them."""

    min_transmittance: float = 1e-3
    """Skip samples whose transmittance is below this; 0 skips none."""

    mask_share: float = 0.5
    """Share of the rays drawn from the mask's pixels; the others are drawn from the body's padded box."""

    held_back: float = 0.05
    """Share of the training views that training starts without. Their error is measured some 30 times, and
    the best field is kept instead of the last. The number of views is rounded, and at most 12; 0 holds back
    none. Steps through scattering use all views."""

    held_back_until: float = 0.6
    """Share of the training from which on these views are trained on as well, and the last field is kept, if
    their error is within 3 % of its least then; 1 holds them back to the end."""

    edge_kernel: int = 0
    """Skip pixels if a square of this many pixels around them holds both performer and background; 0 skips
    none, the paper uses 3."""

    box_padding: float = BOX_PADDING
    """Padding of the body's box in metres, for the pixels drawn."""

    learning_rate: float = 4e-3
    """Adam's learning rate for the networks."""

    grid_rate: float = 2e-2
    """Adam's learning rate for the hash table."""

    decay: float = 0.1
    """Factor by which all rates decay, exponentially, over `decay_steps` steps."""

    decay_steps: int = 0
    """Steps over which the rates decay by `decay`; 0 for the whole training."""

    pose_noise: float = 0.1
    """Standard deviation, in radians, of the noise added to the joint angles that the networks see. New noise
    in each step keeps them from identifying frames by their poses."""

    opacity_weight: float = 0.05
    """Weight of the mean squared difference of opacity and mask."""

    opacity_edge: int = 3
    """That term ignores pixels if a square of this many pixels around them holds both performer and
    background: the performer covers such pixels partly, which a mask of 0 and 255 cannot say. 0 ignores
    none; of images with a matte all pixels count."""

    mask_trust: bool = True
    """Whether that term counts less where the image or other cameras contradict the mask."""

    edge_weight: float = 0.1
    """Weight of the mean density near the band's edge (|l| above 0.8 of the band), in units of the preset's
    `density_gain`, once the image error is below `edge_below`."""

    edge_below: float = 0.005
    """Smoothed mean squared error of the image in sRGB below which the edge term counts."""

    clip: float = 40.0
    """Largest magnitude of an entry of the networks' gradient."""

    seed: int = 0
    """Seed of the initial parameters, rays and jitter."""

    refine: tuple[str, ...] = ()
    """What of the fit is refined with the field, of `pose`, `shape` and `cameras`: joints, place and turn of
    the body by frame, its shape coefficients, rotation, place and focal length by camera. With a scattering
    integrator only during `warm_up`."""

    camera_colours: bool = False
    """Learn an affine map of linear colour for each training camera, whose mean is the identity. With
    a scattering integrator only during `warm_up`."""

    pose_rate: float = 0.015
    """Adam's learning rate for the corrections of poses, in standard deviations of their prior (5° of a
    joint, 20 mm)."""

    shape_rate: float = 0.02
    """Adam's learning rate for the shape's corrections, in standard deviations (10 mm of the surface)."""

    camera_rate: float = 0.006
    """Adam's learning rate for the cameras' corrections, in standard deviations (0.5°, 10 mm, 1 % of the
    focal length)."""

    colour_rate: float = 0.02
    """Adam's learning rate for the cameras' maps of colour, in standard deviations (0.1 of the matrix,
    0.02 of the offset)."""

    refine_prior: float = 1e-5
    """Weight of the corrections' prior: of the sum of their squares in standard deviations, divided by the
    number of training frames."""

    refine_frames: float = 10.0
    """Frames over which the corrections of poses are correlated; 0 for independent frames."""

    refine_outlines: int = 16
    """Rounds that fit what `refine` names to the outlines of the training masks, before the field is
    trained; 0 leaves this to the field."""

    refine_after: int = 200
    """Steps before anything is corrected: the field has no outline yet."""

    checkpoint_seconds: float = 60.0
    """Time between checkpoints in seconds."""

    integrator: str = QUADRATURE
    """`ndf_quadrature`: emission and absorption; `prbvolpath`: scattering under the capture's light."""

    warm_up: int = 1500
    """Steps by quadrature before those through scattering (only with `prbvolpath`)."""

    paths: int = 16
    """Paths a ray, at least 2 (only with `prbvolpath`)."""

    max_depth: int = 12
    """Maximum path depth as Mitsuba counts it: 2 is single scattering (only with `prbvolpath`)."""

    cell: float = 0.0125
    """Spacing in metres of the grid on which paths scatter (only with `prbvolpath`)."""

    def __post_init__(self) -> None:
        for key in ("steps", "rays", "samples", "learning_rate", "grid_rate", "decay", "clip",
                    "pose_rate", "shape_rate", "camera_rate", "colour_rate", "checkpoint_seconds", "cell"):
            self._check(key, 0 < getattr(self, key) < float("inf"), "a number above 0")
        for key in ("seconds", "pose_noise", "edge_kernel", "opacity_edge", "box_padding", "decay_steps",
                    "opacity_weight", "edge_weight", "edge_below", "seed", "min_transmittance", "warm_up",
                    "refine_prior", "refine_frames", "refine_outlines", "refine_after"):
            self._check(key, 0 <= getattr(self, key) < float("inf"), "a number of at least 0")
        self._check("atlas", self.atlas in ("body", "one-piece"), "body or one-piece")
        self._check("bands", self.bands in ("local", "uniform"), "local or uniform")
        self._check("surface", self.surface in ("body", "offset"), "body or offset")
        self._check("min_transmittance", self.min_transmittance < 1, "a transmittance in [0, 1)")
        unknown = [name for name in self.refine if name not in REFINABLE]
        self._check("refine", not unknown and len(set(self.refine)) == len(self.refine),
                    f"each at most once of {', '.join(REFINABLE)}")
        for key in ("paths", "max_depth"):
            self._check(key, getattr(self, key) >= 2, "at least 2")
        self._check("warm_up", self.integrator == QUADRATURE or self.warm_up < self.steps,
                    f"fewer than the {self.steps} steps in all")
        self._check("held_back", 0 <= self.held_back <= 0.5, "a number in [0, 0.5]")
        self._check("held_back_until", 0 <= self.held_back_until <= 1, "a number in [0, 1]")
        self._check("mask_share", 0 <= self.mask_share <= 1, "a number in [0, 1]")

    def _check(self, key: str, good: bool, expected: str) -> None:
        if not good:
            raise InputError(f"option {key.replace('_', '-')}", repr(getattr(self, key)), expected)

    def to_dict(self) -> dict[str, Any]:
        """The options as JSON values."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any], where: str = "training") -> TrainingOptions:
        """The options from JSON values. Raises InputError for an unknown option or a wrong type."""
        # Trainings that were saved before these options existed ran without them.
        before = {"pose_noise": 0.0, "opacity_edge": 0, "min_transmittance": 0.0, "surface": "body",
                  "held_back": 0.0, "mask_trust": False}
        return read_options(cls, before | rename_entries(values, TRAINING_FIELDS), where)

    @classmethod
    def paper(cls) -> TrainingOptions:
        """The published schedule and loss."""
        return cls(steps=200_000, surface="body", edge_kernel=3, learning_rate=5e-4, decay_steps=500_000,
                   opacity_weight=0.0, skip_empty=False, min_transmittance=0.0, pose_noise=0.0,
                   held_back=0.0)
