"""What a synthetic performer wears and does, apart from how much of it is shown: each choice adds or takes away one thing to model."""

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
    """Choices; the defaults are the performer of the sizes' table.

    Attributes:
        motion: of the training frames. `clips`: walking and climbing; `turn`: one pose, turned around the vertical once over the frames;
            `still`: one pose that never moves.
        clothes: `loose` stand off by centimetres; `tight` lie within 12 mm of the body, and the head is shaved.
        folds: whether cloth folds with the pose.
        surface: `mixed`: diffuse cloth, and glossy skin, hair and shoes; `matte`: all of it diffuse; `glossy`: all of it shines.
    """

    motion: str = "clips"
    clothes: str = "loose"
    folds: bool = True
    surface: str = "mixed"

    def __post_init__(self) -> None:
        """Raises InputError at the first choice that there is not."""
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                raise InputError(f"--{name}", repr(getattr(self, name)), f"one of {', '.join(known)}")

    def changes(self) -> dict[str, Any]:
        """What differs from the default, by name."""
        return {name: value for name, value in vars(self).items() if value != getattr(type(self), name)}
