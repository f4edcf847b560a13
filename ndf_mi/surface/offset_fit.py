"""Fitting vertex offsets and a texture together to a capture's training images, from coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.colour import linear_to_srgb
from ndf_mi.surface import schedule as schedules
from ndf_mi.surface.contours import Contours, contour_gradient
from ndf_mi.surface.degenerate import degenerate_triangles, repair
from ndf_mi.surface.posed_mesh import TRAIN_SPP
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.schedule import Progress, Schedule, Search, search, search_frames, train
from ndf_mi.surface.smoothing import SmoothOffsets
from ndf_mi.surface.texture_fit import FittedTexture, Texels, sampler_seeds, search_rate
from ndf_mi.surface.textured import TexturedSurface
from ndf_mi.surface.training_views import TrainingViews

CONTOUR_SAMPLES = 4096
"""Contour points a view."""

MARGIN = 0.12
"""Metres around the body that training images show."""

MASK_WEIGHT = 0.05
"""Weight of the mean squared error of coverage against the masks, away from their edges; the field's for
opacity.
"""

STRAIN_WEIGHT = 1e-3
"""Weight of the offsets' mean squared gradient over the surface."""

LENGTHS = ((1.0, 4.0), (0.5, 2.0), (0.15, 1.0))
"""(factor of the rates, smoothing length in pixels at the body's distance): the length from that factor down.
"""

REPAIR_STEPS = 25
"""Steps between searches for degenerate triangles."""


@dataclass(frozen=True)
class FittedOffsets:
    """Offsets and how they were found.

    Attributes:
        offsets: (V, 3) float32 metres, in the frames of `RestFrames`, with no degenerate triangle.
        texture: the texture that goes with them; its loss is relative to the body's rectangles without the
            margin.
        search: the first step of the offsets, metres.
    """

    offsets: np.ndarray
    texture: FittedTexture
    search: Search


class OffsetFit:
    """Texture and offsets under optimisation. Both rates fall together, and the smoothing length with them.

    A step takes the gradient of the images' error through what each sample sees and through the motion of
    contours (`contours`), maps it to the body at rest (`rest_frames`) and moves along it smoothed
    (`smoothing`). Every `REPAIR_STEPS` steps, the surroundings of degenerate triangles return to the offsets
    of the last such check.

    Args:
        surface: the posed body; its vertices and texture change as training goes.
        rest: of the same capture.
        capture: whose `train` split is used.
        size: texels a side.
        rate: Adam's first learning rate of the texture.
        offset_rate: first step of the offsets, metres.
        seed: of the order of frames and of the samples.
        frames: a subset of the training frames; all by default.

    Raises:
        InputError: the capture has no training images, or no camera sees the body.
    """

    def __init__(self, surface: TexturedSurface, rest: RestFrames, capture: Capture, size: int, rate: float,
                 offset_rate: float, seed: int, frames: Sequence[int] | None = None) -> None:
        self._surface = surface
        self._views = TrainingViews(capture, seed, frames, MARGIN, masks=True)
        self._seed = seed
        self._rest = rest
        self._faces = capture.body.faces
        self._contours = Contours(self._faces)
        self._random = np.random.default_rng([seed, 1])
        self._pixel = _pixel_size(capture)
        self._smooth = SmoothOffsets(rest.vertices, self._faces)
        self._checked = self._smooth.offsets.copy()
        self._first_rate = offset_rate
        self.frames = self._views.frames
        self.texels = Texels(size, self._views.mean_colour(), rate)
        self.set_rate(1.0)

    def offsets(self) -> np.ndarray:
        """(V, 3) float32 metres at rest, with no degenerate triangle."""
        known = repair(self._rest.vertices, self._smooth.offsets, self._faces, self._checked)
        return known.astype(np.float32)

    def set_rate(self, factor: float) -> None:
        """Sets both rates to `factor` of their first values, and the smoothing length to match."""
        self.texels.set_rate(factor)
        self._rate = factor * self._first_rate
        pixels = [length for most, length in LENGTHS if factor <= most * (1 + 1e-6)][-1]
        self._smooth.set_length(pixels * self._pixel)

    def step(self, number: int) -> float:
        """One update from the next frame's images; returns their sRGB squared error by the area without
        margin.
        """
        frame, views = self._views.next()
        posed = self._rest.posed(frame, self._smooth.offsets)
        vertices = mi.Float(posed.ravel())
        dr.enable_grad(vertices)
        self._surface.set_vertices(vertices)
        self._surface.set_texture(self.texels.linear)
        seeds = sampler_seeds(self._seed, number, len(views))
        layers = [self._surface.layers(camera, TRAIN_SPP, seed, rectangle)
                  for seed, (camera, rectangle, _) in zip(seeds, views, strict=True)]
        targets = [np.dstack([truth, self._views.coverage(camera, frame)]) for camera, _, truth in views]
        error, adjoints = _image_loss(layers, targets, self._views.area * len(views))
        moved = np.zeros_like(posed, dtype=np.float64)
        planes = self._contours.planes(posed)
        for (camera, rectangle, _), adjoint in zip(views, adjoints, strict=True):
            samples = self._contours.sample(posed, camera, CONTOUR_SAMPLES, self._random, planes)
            if samples is not None:
                moved += contour_gradient(self._surface, posed, camera, samples, adjoint, rectangle)
        pairs = zip(layers, adjoints, strict=True)
        dr.backward(sum((dr.sum(layer.array * adjoint.array) for layer, adjoint in pairs), mi.Float(0)))
        self.texels.step(vertices.grad)
        self._step_offsets(number, frame, moved + vertices.grad.numpy().reshape(-1, 3))
        return error

    def _step_offsets(self, number: int, frame: int, gradient: np.ndarray) -> None:
        smooth = self._smooth
        smooth.step(self._rest.vjp(frame, gradient) + STRAIN_WEIGHT * smooth.strain()[1], self._rate)
        if number % REPAIR_STEPS == 0:
            if degenerate_triangles(self._rest.vertices, smooth.offsets, self._faces).any():
                smooth.replace(repair(self._rest.vertices, smooth.offsets, self._faces, self._checked))
            self._checked = smooth.offsets.copy()


def fit_offsets(surface: TexturedSurface, rest: RestFrames, capture: Capture, size: int,
                rate: float | None = None, offset_rate: float | None = None, seconds: float | None = None,
                seed: int = 0, progress: Progress | None = None,
                schedule: Schedule | None = None) -> FittedOffsets:
    """Fits one set of vertex offsets for all frames, together with a texture, to the capture's `train` split.

    Args:
        surface: the posed body; its vertices and texture change.
        rest: of the same capture.
        offset_rate: first step of the offsets, metres; None searches for the best.
        capture, size, rate, seconds, seed, progress, schedule: as for `fit_texture`.

    Raises:
        InputError: the capture has no training images, or no camera sees the body.
    """
    schedule = schedule or schedules.DEFAULT
    found = Search(rate) if rate else search_rate(surface, capture, size, seed, schedule)
    frames = search_frames(capture.splits["train"].frames, schedule)
    step = Search(offset_rate) if offset_rate else search(
        lambda first: OffsetFit(surface, rest, capture, size, found.rate, first, seed, frames),
        schedule.offset_rates, schedule)
    fit = OffsetFit(surface, rest, capture, size, found.rate, step.rate, seed)
    texture = fit.texels.fitted(found, train(fit, schedule, seconds, progress))
    return FittedOffsets(fit.offsets(), texture, step)


def _image_loss(layers: Sequence[mi.TensorXf], targets: Sequence[np.ndarray],
                area: float) -> tuple[float, list[mi.TensorXf]]:
    """The images' squared error by `area`, and the gradient of the whole loss in each of the layers.

    Args:
        layers: of each view (h, w, 4), linear radiance and coverage.
        targets: of each view (h, w, 5), sRGB, mask, and 1 where the mask is valid.
        area: pixels.
    """
    leaves = [mi.TensorXf(dr.detach(layer)) for layer in layers]
    dr.enable_grad(leaves)
    error, coverage = mi.Float(0), mi.Float(0)
    for leaf, target in zip(leaves, targets, strict=True):
        truth = mi.TensorXf(target)
        error += dr.sum(dr.square(linear_to_srgb(leaf[:, :, :3]) - truth[:, :, :3]), axis=None).array
        coverage += dr.sum(truth[:, :, 4] * dr.square(leaf[:, :, 3] - truth[:, :, 3]), axis=None).array
    dr.backward((error / 3 + MASK_WEIGHT * coverage) / area)
    adjoints = [mi.TensorXf(leaf.grad) for leaf in leaves]
    dr.eval(adjoints, error)
    return float(error[0]) / (3 * area), adjoints


def _pixel_size(capture: Capture) -> float:
    """The side of a training camera's pixel at the body's distance, metres; the mean over the cameras."""
    split = capture.splits["train"]
    centre = capture.poses.vertices[capture.poses.index(split.frames[0])].mean(axis=0)
    cameras = [capture.cameras[name] for name in split.cameras]
    return float(np.mean([np.linalg.norm(camera.position - centre) / camera.fl_x for camera in cameras]))
