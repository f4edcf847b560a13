"""The choices that make a synthetic performer easier or harder to model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ndf_mi.errors import InputError

CHOICES = {
    "motion": ("clips", "turn", "still"),
    "clothes": ("loose", "tight"),
    "surface": ("mixed", "matte", "glossy"),
}


@dataclass(frozen=True)
class Look:
    """The choices; the defaults make the standard performer.

    Attributes:
        motion: in the training frames. `clips`: walking and climbing; `turn`: one pose that turns once around
            the vertical; `still`: one pose.
        clothes: `loose` clothes are centimetres away from the body; `tight` ones are within 12 mm, without
            hair.
        folds: whether cloth folds with the pose.
        surface: `mixed`: diffuse cloth with glossy skin, hair and shoes; `matte`: everything is diffuse;
            `glossy`: everything is glossy.
    """

    motion: str = "clips"
    clothes: str = "loose"
    folds: bool = True
    surface: str = "mixed"

    def __post_init__(self) -> None:
        """Raises InputError at the first unknown choice."""
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                raise InputError(f"--{name}", repr(getattr(self, name)), f"one of {', '.join(known)}")

    def changes(self) -> dict[str, Any]:
        """The choices that differ from the default, by name."""
        return {name: value for name, value in vars(self).items() if value != getattr(type(self), name)}
