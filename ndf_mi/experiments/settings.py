"""Settings that experiments share, and one way to check numbers."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from ndf_mi.errors import InputError
from ndf_mi.experiments import protocols


def at_least(settings: Any, **limits: int) -> None:
    """Raises InputError if a whole number is below its limit, by name; None stands for a default."""
    for name, low in limits.items():
        value = getattr(settings, name)
        if value is not None and value < low:
            raise InputError(option(name), repr(value), f"a whole number from {low} on")


def positive(settings: Any, *names: str) -> None:
    """Raises InputError unless numbers are above 0 and finite; None stands for a default."""
    for name in names:
        value = getattr(settings, name)
        if value is not None and not 0 < value < math.inf:
            raise InputError(option(name), repr(value), "a finite number above 0")


def option(name: str) -> str:
    """A setting as the user knows it."""
    return f"option {name.replace('_', '-')}"


@dataclass(frozen=True)
class Evaluation:
    """Which images are measured, and how they are rendered.

    Attributes:
        max_images: images of each held-out split; None takes the protocol's number.
        sequence: successive frames of each split that temporal consistency is measured on; 0 leaves it out.
        samples: candidate samples a ray.
        seed: seed of the choice of images and of trainings.
        protocol: name of the protocol, see `ndf_mi.experiments.protocols`.
    """

    max_images: int | None = None
    sequence: int = 12
    samples: int = 128
    seed: int = 0
    protocol: str = protocols.DEFAULT.name

    def __post_init__(self) -> None:
        protocols.named(self.protocol)
        at_least(self, max_images=1, samples=1, sequence=0, seed=0)
        if self.sequence == 1:
            raise InputError("option sequence", "1", "at least 2, or 0 to leave temporal consistency out")

    def to_dict(self) -> dict[str, Any]:
        """JSON values, with the protocol's number of images where none was given."""
        limit = protocols.named(self.protocol).max_images if self.max_images is None else self.max_images
        return asdict(self) | {"max_images": limit}
