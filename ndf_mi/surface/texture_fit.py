"""Optimising the mesh's texture: a step, schedules for a given time and until the loss stops falling, a rate sweep."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.surface.texture import fill_unseen
from ndf_mi.surface.textured import TexturedSurface
from ndf_mi.surface.training_views import TrainingViews

Progress = Callable[[float, int, float], None]

RATES = (3e-3, 1e-2, 3e-2, 1e-1, 3e-1)
TRAIN_SPP = 4
SWEEP_FRAMES = 5
SWEEP_STEPS = 40
#: The rate's share that is left at the end of a fit of given length.
FINAL_RATE = 0.03
#: Windows whose loss falls by less than this share are a plateau.
TOLERANCE = 5e-3
#: Fewest steps in a window; windows hold whole passes over the frames, so that their means compare.
WINDOW_STEPS = 50
#: How often a plateau lowers the rate before it counts as convergence, and by what factor.
DROPS = 3
DROP = 10**-0.5
MAX_STEPS = 8000


@dataclass(frozen=True)
class Training:
    """How a fit went.

    Attributes:
        rate: Adam's first learning rate of the texture, in sRGB units a step.
        sweep: training loss that each rate tried had reached, keyed by the rate as text; empty if the rate was given.
        sweep_seconds: wall-clock seconds of all sweeps; not part of `seconds`.
        seconds, steps: wall-clock seconds and steps of the fit.
        converged: whether it ended because the loss stopped falling.
        history: [step, seconds, loss], means over windows; the loss is the sRGB mean squared error in the body's rectangle.
    """

    rate: float
    sweep: dict[str, float] = field(default_factory=dict)
    sweep_seconds: float = 0.0
    seconds: float = 0.0
    steps: int = 0
    converged: bool = False
    history: list[tuple[int, float, float]] = field(default_factory=list)


@dataclass(frozen=True)
class FittedTexture:
    """A texture (size, size, 3) float32 sRGB without holes; `seen` (size, size) bool, the texels that training images touched."""

    texture: np.ndarray
    seen: np.ndarray
    training: Training


def fit_texture(
    surface: TexturedSurface,
    capture: Capture,
    size: int,
    rate: float | None = None,
    seconds: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    kind: type[TextureFit] | None = None,
) -> FittedTexture:
    """Fits a texture to the capture's `train` split by Adam on the sRGB mean squared error.

    Args:
        surface: the posed body; its frame and texture change.
        capture: with a `train` split.
        size: texels a side.
        rate: learning rate; None takes the best of a sweep.
        seconds: time to train for, with a rate that decays over it; None trains until the loss stops falling. The clock
            starts when all images are in memory.
        seed: of the order of images and of the samples.
        progress: called after each step with (seconds, steps, loss).
        kind: how a step is taken; `TextureFit` by default.

    Raises:
        InputError: the capture has no training images, or no camera sees the body.
    """
    kind = kind or TextureFit
    sweep: dict[str, float] = {}
    taken = 0.0
    if not rate:
        rate, sweep, taken = best_rate(surface, capture, size, seed, kind)
    fit = kind(surface, capture, size, rate, seed)
    converged = fit.train(seconds, progress)
    return fit.result(Training(rate, sweep, taken, converged=converged))


class TextureFit:
    """A texture under optimisation: Adam on sRGB texels; training frames in shuffled passes, up to four cameras a step.

    Texels that a step does not touch keep their value and their moments (masked updates).

    Args:
        surface: the posed body; its frame and texture change as training goes.
        capture: whose `train` split is used.
        size: texels a side.
        rate: learning rate.
        seed: of the order of frames and of the samples.
        frames: a subset of the training frames; all by default.
        margin: metres around the body that the images trained on show, too.
        masks: whether the masks are trained on, too.
    """

    def __init__(
        self,
        surface: TexturedSurface,
        capture: Capture,
        size: int,
        rate: float,
        seed: int,
        frames: Sequence[int] | None = None,
        margin: float = 0.0,
        masks: bool = False,
    ) -> None:
        self._surface = surface
        self._views = TrainingViews(capture, seed, frames, margin, masks)
        self._rate = rate
        self._seed = seed
        self._optimizer = mi.ad.Adam(lr=rate, mask_updates=True)
        self._optimizer["texture"] = mi.TensorXf(np.full((size, size, 3), self._views.mean_colour(), dtype=np.float32))
        self._seen = dr.zeros(mi.UInt32, size * size * 3)
        self._start = time.perf_counter()
        self.steps = 0
        self.history: list[tuple[int, float, float]] = []

    @property
    def seconds(self) -> float:
        """Wall-clock time since the images had been decoded and the fit begun, as a field's training time is counted."""
        return time.perf_counter() - self._start

    def texture(self) -> np.ndarray:
        """(size, size, 3) float32, sRGB-encoded, at least 0."""
        return self._optimizer["texture"].numpy()

    def seen(self) -> np.ndarray:
        """(size, size) bool: the texels that some training sample has touched."""
        shape = self._optimizer["texture"].shape
        return self._seen.numpy().reshape(shape).any(axis=-1)

    def step(self) -> float:
        """One update from the next frame's images; returns their sRGB mean squared error in the body's rectangle."""
        frame, views = self._views.next()
        self._surface.set_frame(frame)
        texture = self._optimizer["texture"]
        self._surface.set_texture(srgb_to_linear(texture))
        losses = []
        for index, (camera, rectangle, truth) in enumerate(views):
            image = linear_to_srgb(self._surface.render(camera, TRAIN_SPP, self._sampler_seed(index, views), rectangle))
            losses.append(dr.mean(dr.square(image - mi.TensorXf(truth)), axis=None))
        loss = sum(losses[1:], losses[0]) / len(losses)
        dr.backward(loss)
        self._step_texture()
        dr.eval(self._seen, self._optimizer["texture"], loss)
        self.steps += 1
        return float(loss.array[0])

    def _sampler_seed(self, index: int, views: Sequence[object]) -> int:
        return (self._seed * 7919 + self.steps) * len(views) + index

    def _step_texture(self) -> None:
        """Adam's step from the gradient that the texture holds."""
        gradient = dr.grad(self._optimizer["texture"])
        self._seen |= dr.select(gradient.array != 0, mi.UInt32(1), mi.UInt32(0))
        self._optimizer.step()
        self._optimizer["texture"] = dr.maximum(dr.detach(self._optimizer["texture"]), 0)

    def set_rate(self, rate: float) -> None:
        """Changes the learning rate from the next step on."""
        self._optimizer.set_learning_rate(rate)

    def train(self, seconds: float | None, progress: Progress | None = None) -> bool:
        """Trains for `seconds`, or until the loss stops falling where None; whether it did stop falling."""
        return self.to_convergence(progress) if seconds is None else self.for_seconds(seconds, progress)

    def result(self, training: Training) -> FittedTexture:
        """The texture, its holes filled, and `training` with this fit's time, steps and history."""
        seen = self.seen()
        known = replace(training, seconds=self.seconds, steps=self.steps, history=list(self.history))
        return FittedTexture(fill_unseen(self.texture(), seen), seen, known)

    def for_seconds(self, seconds: float, progress: Progress | None = None) -> bool:
        """Trains for `seconds` while the rate decays exponentially to `FINAL_RATE` of itself. Returns False."""
        window: list[float] = []
        while not self.steps or self.seconds < seconds:
            self.set_rate(self._rate * FINAL_RATE ** min(self.seconds / seconds, 1) if seconds > 0 else self._rate)
            self._log(window, progress)
        return False

    def to_convergence(self, progress: Progress | None = None, max_steps: int = MAX_STEPS) -> bool:
        """Trains until the loss stops falling, lowering the rate at plateaus; True unless `max_steps` came first."""
        best, drops, window, rate = np.inf, 0, list[float](), self._rate
        while self.steps < max_steps:
            self._log(window, progress)
            if window:
                continue
            mean = self.history[-1][2]
            if mean > best * (1 - TOLERANCE):
                drops += 1
                if drops > DROPS:
                    return True
                rate *= DROP
                self.set_rate(rate)
            best = min(best, mean)
        return False

    def for_steps(self, steps: int) -> float:
        """Trains for `steps` with the rate decaying to `FINAL_RATE`; returns the mean loss over the last pass."""
        losses = []
        for index in range(steps):
            self.set_rate(self._rate * FINAL_RATE ** (index / steps))
            losses.append(self.step())
        return float(np.mean(losses[-self._views.frames :]))

    def _log(self, window: list[float], progress: Progress | None) -> None:
        """One step; a full window is averaged into the history and emptied."""
        loss = self.step()
        window.append(loss)
        passes = -(-WINDOW_STEPS // self._views.frames)
        if len(window) == passes * self._views.frames:
            self.history.append((self.steps, self.seconds, float(np.mean(window))))
            window.clear()
        if progress is not None:
            progress(self.seconds, self.steps, loss)


def best_rate(
    surface: TexturedSurface, capture: Capture, size: int, seed: int, fit: type[TextureFit] = TextureFit
) -> tuple[float, dict[str, float], float]:
    """The rate of `RATES` with the lowest training loss after `SWEEP_STEPS` steps on `SWEEP_FRAMES` training frames.

    Returns the rate, the loss of each by the rate as text, and the seconds that it took.
    """
    start = time.perf_counter()
    chosen = sweep_frames(capture)
    losses = {rate: fit(surface, capture, size, rate, seed, chosen).for_steps(SWEEP_STEPS) for rate in RATES}
    best = min(losses, key=lambda rate: losses[rate])
    return best, {f"{rate:g}": loss for rate, loss in losses.items()}, time.perf_counter() - start


def sweep_frames(capture: Capture) -> list[int]:
    """`SWEEP_FRAMES` training frames, spread evenly; all if there are no more."""
    train = capture.splits["train"].frames
    return [train[i] for i in np.unique(np.linspace(0, len(train) - 1, SWEEP_FRAMES).round().astype(int))]
