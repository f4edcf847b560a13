"""The contract of a method: what experiments ask of everything that they compare.

A method draws the performer of one capture. It is created by the registry, then either trained (`fit`) or
read from a folder (`load`), and then it renders. Experiments and reports use nothing of a method but
`Method`, and `expect_views` for those that can only show some views.

`metadata` returns JSON values under keys of the method's choice. These keys have a meaning for experiments
and reports; all of them are optional:

    seconds     wall-clock seconds of training
    steps       steps of training
    converged   whether training ended because the loss stopped falling
    budget      seconds that training was given; None for training to convergence
    seed        the seed of training
    capture     digest of the capture that it was trained on
    options     the options that it was created with: {name: value}
    tuned       options that a search on the training images has found: {name: value}. Later trainings of the
                same method on the same capture may be created with them and need not search again
    history     the training curve: [step, seconds, mean squared error in sRGB], in order
    held_back   the curve of training views while training does not draw them: [step, seconds, box PSNR in
                dB], in order
    kept_step   the step whose parameters are rendered, where that need not be the last
    note        how it was trained or where its pictures come from, one sentence for the report
    noise_psnr  PSNR in dB that the sampling noise of the last picture rendered would have by itself
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from ndf_mi.errors import InputError

if TYPE_CHECKING:
    from ndf_mi.capture.camera import Camera
    from ndf_mi.capture.capture import Capture

Progress = Callable[[float, int, float], None]
"""Called after a step of training with seconds, steps so far, and the step's mean squared error in sRGB."""


@dataclass(frozen=True)
class Budget:
    """How long a method may train.

    Args:
        seconds: wall-clock seconds, counted from when all images are in memory; None trains to convergence,
            or through the whole schedule of a method that has a fixed one.
        seed: seed of everything random in training, from 0 on.

    Raises:
        InputError: the time is not above 0 and finite, or the seed is negative.
    """

    seconds: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.seconds is not None and not 0 < self.seconds < float("inf"):
            raise InputError("training budget", f"{self.seconds!r} s", "a number of seconds above 0")
        if self.seed < 0:
            raise InputError("seed", repr(self.seed), "a whole number from 0 on")


class Renderer(Protocol):
    """Something that draws the performer of one capture: all that measuring needs.

    `key` is its name in the registry and on the command line, `label` that in tables and charts.
    """

    key: str
    label: str

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """The performer at `frame` over the capture's background: (h, w, 3) float32 sRGB in [0, 1]."""
        ...

    def metadata(self) -> dict[str, Any]:
        """JSON values that describe the method and its training; the module's docstring lists the keys."""
        ...

    def cache_key(self) -> str:
        """A digest of everything that the images depend on: equal keys mean equal images."""
        ...


class Trainable(Protocol):
    """Something that is trained on a capture, or read from a folder where it was saved."""

    key: str
    label: str

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Trains on the capture's `train` split.

        Raises:
            InputError: the method cannot be trained, or the capture lacks what it needs.
        """
        ...

    def metadata(self) -> dict[str, Any]:
        """As `Renderer.metadata`."""
        ...

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Writes everything that `load` needs to render again; files that are there are replaced."""
        ...

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Reads what `save` wrote, in place of training. The body and its poses come from the capture.

        Raises:
            InputError: a file is missing or damaged, or does not belong to the capture.
        """
        ...


class Method(Trainable, Renderer, Protocol):
    """What `ndf-mi compare` measures."""


@runtime_checkable
class Resumable(Protocol):
    """A method whose training survives being stopped."""

    def fit_in(self, folder: str | os.PathLike[str], capture: Capture, budget: Budget,
               progress: Progress | None = None) -> None:
        """As `Trainable.fit` and `save` to the folder; continues a stopped training with the same capture,
        options and budget that the folder holds, and replaces any other.
        """
        ...


@runtime_checkable
class Configured(Protocol):
    """A method that is trained by settings of its own, which may differ between versions."""

    def training_settings(self) -> dict[str, Any]:
        """JSON values: a training with other settings is done again."""
        ...


@dataclass(frozen=True)
class Light:
    """Light that a scene is lit by.

    Attributes:
        name: what experiments call it, such as `seen`; part of cache keys.
        emitters: entries of a Mitsuba scene's dictionary.
    """

    name: str
    emitters: dict[str, Any]


class Relightable(Trainable, Protocol):
    """What `ndf-mi relight` measures: it is trained under the capture's light and shown under any."""

    def under(self, light: Light, frames: Sequence[int], spp: int) -> Renderer:
        """The performer in some light.

        Args:
            light: what lights the scene.
            frames: all frames that will be rendered.
            spp: samples a pixel, an even number.
        """
        ...


@runtime_checkable
class LimitedViews(Protocol):
    """A method that cannot render every view, such as one that reads pictures from files."""

    def check_views(self, views: Sequence[tuple[str, int]]) -> None:
        """Raises InputError, listing what is missing, unless every (camera, frame) can be rendered."""
        ...


def expect_views(method: Renderer, views: Sequence[tuple[str, int]]) -> None:
    """Raises InputError unless the method can render every (camera, frame). Call it before measuring."""
    if isinstance(method, LimitedViews):
        method.check_views(views)
