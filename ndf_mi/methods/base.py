"""What evaluation asks of a method, and what it asks of one that it trains itself."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from ndf_mi.capture.camera import Camera
    from ndf_mi.capture.capture import Capture


class Method(Protocol):
    """Something that draws the performer of one capture: all that evaluation and the report need."""

    name: str

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """The performer at `frame` over the capture's background: (h, w, 3) float32 sRGB in [0, 1]."""
        ...

    def facts(self) -> dict[str, Any]:
        """What the report says of it: JSON values, among them `seconds`, the wall-clock time of training."""
        ...


class Trainable(Method, Protocol):
    """A method that the comparison trains on the capture's `train` split."""

    def fit(self, capture: Capture, seconds: float | None = None, seed: int = 0) -> None:
        """Trains for `seconds` of wall-clock time, or to convergence where None."""
        ...

    def save(self, path: str | PathLike[str]) -> None:
        """Writes everything needed to render again into the folder `path`."""
        ...

    @classmethod
    def load(cls, path: str | PathLike[str], capture: Capture) -> Trainable:
        """Reads what `save` wrote; the body and its poses are the capture's.

        Raises:
            InputError: a file is missing, or is not what `save` writes.
        """
        ...
