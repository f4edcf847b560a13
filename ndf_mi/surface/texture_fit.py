"""Fitting a texture to a capture's training images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.surface import schedule as schedules
from ndf_mi.surface.posed_mesh import PosedMesh
from ndf_mi.surface.schedule import Progress, Schedule, Search, Training, search, search_frames, train
from ndf_mi.surface.texture import fill_unseen
from ndf_mi.surface.training_views import TrainingViews


@dataclass(frozen=True)
class FittedTexture:
    """A texture and how it was found.

    Attributes:
        texture: (size, size, 3) float32 sRGB, at least 0, without holes.
        seen: (size, size) bool, the texels that training images touched.
        search: Adam's first learning rate in sRGB units.
        training: how training went; the loss is the sRGB mean squared error in the body's rectangle.
    """

    texture: np.ndarray
    seen: np.ndarray
    search: Search
    training: Training


class Texels:
    """A texture that Adam optimises in sRGB. Texels that a step does not touch keep their value and their
    moments.

    Args:
        size: texels a side.
        colour: (3,) sRGB, the first value of all texels.
        rate: Adam's first learning rate.
        limit: largest value of a texel; None for no limit. The smallest one is 0.
    """

    def __init__(self, size: int, colour: np.ndarray, rate: float, limit: float | None = None) -> None:
        self._rate = rate
        self._limit = limit
        self._adam = mi.ad.Adam(lr=rate, mask_updates=True)
        self._adam["texture"] = mi.TensorXf(np.full((size, size, 3), colour, dtype=np.float32))
        self._seen = dr.zeros(mi.UInt32, size * size * 3)

    @property
    def linear(self) -> mi.TensorXf:
        """(size, size, 3) linear values, attached."""
        return srgb_to_linear(self._adam["texture"])

    def set_rate(self, factor: float) -> None:
        """Sets the learning rate to `factor` of its first value, from the next step on."""
        self._adam.set_learning_rate(factor * self._rate)

    def step(self, *computed: mi.Float | mi.TensorXf) -> None:
        """Takes a step along the gradient that the texture has; evaluates `computed` in the same kernels."""
        gradient = dr.grad(self._adam["texture"])
        self._seen |= dr.select(gradient.array != 0, mi.UInt32(1), mi.UInt32(0))
        self._adam.step()
        texture = dr.maximum(dr.detach(self._adam["texture"]), 0)
        self._adam["texture"] = texture if self._limit is None else dr.minimum(texture, self._limit)
        dr.eval(self._seen, self._adam["texture"], *computed)

    def values(self) -> np.ndarray:
        """(size, size, 3) float32 sRGB, as optimised."""
        return self._adam["texture"].numpy()

    def seen(self) -> np.ndarray:
        """(size, size) bool, the texels that some gradient touched."""
        return self._seen.numpy().reshape(self._adam["texture"].shape).any(axis=-1)

    def fitted(self, search: Search, training: Training) -> FittedTexture:
        """The texture with its holes filled, with how it was found."""
        seen = self.seen()
        return FittedTexture(fill_unseen(self.values(), seen), seen, search, training)


class TextureFit:
    """A texture under optimisation; training frames in shuffled passes, up to four cameras a step.

    Args:
        surface: the posed body; its frame and texture change as training goes.
        capture: whose `train` split is used.
        size: texels a side.
        rate: Adam's first learning rate.
        seed: of the order of frames and of the samples.
        frames: a subset of the training frames; all by default.

    Raises:
        InputError: the capture has no training images, or no camera sees the body.
    """

    def __init__(self, surface: PosedMesh, capture: Capture, size: int, rate: float, seed: int,
                 frames: Sequence[int] | None = None) -> None:
        self._surface = surface
        self._views = TrainingViews(capture, seed, frames)
        self._seed = seed
        self.frames = self._views.frames
        self.texels = Texels(size, self._views.mean_colour(), rate, surface.limit)

    def set_rate(self, factor: float) -> None:
        """Sets the learning rate to `factor` of its first value."""
        self.texels.set_rate(factor)

    def step(self, number: int) -> float:
        """One update from the next frame's images; returns their sRGB mean squared error in the rectangle."""
        frame, views = self._views.next()
        self._surface.set_frame(frame)
        seeds = sampler_seeds(self._seed, number, len(views))
        loss = self._surface.backward(self.texels.linear, views, seeds)
        self.texels.step(loss)
        return float(loss[0])


def fit_texture(surface: PosedMesh, capture: Capture, size: int, rate: float | None = None,
                seconds: float | None = None, seed: int = 0, progress: Progress | None = None,
                schedule: Schedule | None = None) -> FittedTexture:
    """Fits a texture to the capture's `train` split by Adam on the sRGB mean squared error.

    Args:
        surface: the posed body; its frame and texture change.
        capture: with a `train` split.
        size: texels a side.
        rate: Adam's first learning rate; None searches for the best.
        seconds: time to train for, from when all images are in memory; None trains until the loss stops
            falling.
        seed: of the order of images and of the samples.
        progress: called after each step.
        schedule: when rates fall and when training ends.

    Raises:
        InputError: the capture has no training images, or no camera sees the body.
    """
    schedule = schedule or schedules.DEFAULT
    found = Search(rate) if rate else search_rate(surface, capture, size, seed, schedule)
    fit = TextureFit(surface, capture, size, found.rate, seed)
    return fit.texels.fitted(found, train(fit, schedule, seconds, progress))


def search_rate(surface: PosedMesh, capture: Capture, size: int, seed: int, schedule: Schedule) -> Search:
    """The best learning rate of a texture; arguments as for `fit_texture`."""
    frames = search_frames(capture.splits["train"].frames, schedule)
    return search(lambda rate: TextureFit(surface, capture, size, rate, seed, frames),
                  schedule.texture_rates, schedule)


def sampler_seeds(seed: int, step: int, views: int) -> list[int]:
    """A seed for the samples of each view in a step."""
    return [(seed * 7919 + step) * views + view for view in range(views)]
