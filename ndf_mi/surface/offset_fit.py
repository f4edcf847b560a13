"""Optimising the mesh's vertex offsets together with its texture, from coarse to fine."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.surface import texture_fit as mesh_fit
from ndf_mi.surface.contour import Contours, contour_gradient
from ndf_mi.surface.degenerate import repair, unsound
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.smoothing import SmoothOffsets
from ndf_mi.surface.texture_fit import TRAIN_SPP, FittedTexture, Progress, TextureFit, Training, best_rate
from ndf_mi.surface.textured import TexturedSurface

#: First steps of the offsets that are tried, metres. The sweep's few steps favour large ones: of 1e-1, which it would take, a training
#: of 280 steps on the capture `quick` ended 0.7 dB behind one of 3e-2, on training and held-out views alike.
OFFSET_RATES = (1e-2, 2e-2, 4e-2)
#: Contour points a view.
CONTOUR_SAMPLES = 4096
#: Metres around the body that the images trained on show.
MARGIN = 0.12
#: Of the mean squared error of coverage against the masks, away from their edges; the field's weight of opacity.
MASK_WEIGHT = 0.05
#: Of the offsets' mean squared gradient over the surface.
STRAIN_WEIGHT = 1e-3
#: Smoothing lengths in pixels at the body's distance, each from where the rate is at most this share of its first.
LENGTHS = ((1.0, 4.0), (0.5, 2.0), (0.15, 1.0))
#: Steps between looks for triangles that need repairing.
MEND_STEPS = 25


@dataclass(frozen=True)
class FittedOffsets:
    """Offsets and the texture that goes with them.

    Attributes:
        offsets: (V, 3) float32 metres, in the frames of `RestFrames`.
        texture: the texture and how the fit went.
        rate: first step of the offsets, metres.
        sweep: training loss that each first step tried had reached, keyed by the step as text; empty if it was given.
    """

    offsets: np.ndarray
    texture: FittedTexture
    rate: float
    sweep: dict[str, float] = field(default_factory=dict)


def fit_offsets(
    surface: TexturedSurface,
    rest: RestFrames,
    capture: Capture,
    size: int,
    rate: float | None = None,
    offset_rate: float | None = None,
    seconds: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> FittedOffsets:
    """Fits one set of vertex offsets for all frames, together with a texture, to the capture's `train` split.

    Args:
        surface: the posed body; its vertices and texture change.
        rest: of the same capture.
        offset_rate: first step of the offsets, metres; None takes the best of a sweep.
        capture, size, rate, seconds, seed, progress: as for `fit_texture`.

    Raises:
        InputError: as `fit_texture`.
    """
    sweep: dict[str, float] = {}
    offset_sweep: dict[str, float] = {}
    taken = more = 0.0
    if not rate:
        rate, sweep, taken = best_rate(surface, capture, size, seed)
    if not offset_rate:
        offset_rate, offset_sweep, more = best_offset_rate(surface, rest, capture, size, rate, seed)
    fit = OffsetFit(surface, rest, capture, size, rate, offset_rate, seed)
    converged = fit.train(seconds, progress)
    texture = fit.result(Training(rate, sweep, taken + more, converged=converged))
    return FittedOffsets(fit.offsets(), texture, offset_rate, offset_sweep)


class OffsetFit(TextureFit):
    """Texture and offsets under optimisation; both rates decay alike, and the smoothing length with them.

    A step takes the gradient of the images' error through what is seen at each sample and through the motion of the
    contours (`contour`), pulls it back to rest (`rest`) and goes along it smoothed (`smoothing`). Every `MEND_STEPS`
    steps the surroundings of triangles that turned over go back to what they were the last time (`soundness`).

    Args:
        surface: the posed body; its vertices and texture change as training goes.
        rest: of the same capture.
        capture: whose `train` split is used.
        size: texels a side.
        rate: learning rate of the texture.
        offset_rate: first step of the offsets, metres.
        seed: of the order of frames and of the samples.
        frames: a subset of the training frames; all by default.
    """

    def __init__(
        self,
        surface: TexturedSurface,
        rest: RestFrames,
        capture: Capture,
        size: int,
        rate: float,
        offset_rate: float,
        seed: int,
        frames: Sequence[int] | None = None,
    ) -> None:
        super().__init__(surface, capture, size, rate, seed, frames, MARGIN, masks=True)
        self._rest = rest
        self._faces = capture.body.faces
        self._contours = Contours(self._faces)
        self._random = np.random.default_rng([seed, 1])
        self._pixel = _pixel_size(capture)
        self._smooth = SmoothOffsets(rest.vertices, self._faces)
        self._sound = self._smooth.offsets.copy()
        self._first_offset_rate = self._offset_rate = offset_rate
        self.set_rate(rate)

    def offsets(self) -> np.ndarray:
        """(V, 3) float32 metres at rest, with every triangle sound."""
        return repair(self._rest.vertices, self._smooth.offsets, self._faces, self._sound).astype(np.float32)

    def set_rate(self, rate: float) -> None:
        """Changes the texture's learning rate from the next step on, the offsets' in proportion, and the smoothing."""
        super().set_rate(rate)
        share = rate / self._rate
        self._offset_rate = share * self._first_offset_rate
        pixels = [length for most, length in LENGTHS if share <= most * (1 + 1e-6)][-1]
        self._smooth.set_length(pixels * self._pixel)

    def step(self) -> float:
        """One update from the next frame's images; returns their sRGB squared error by the body's rectangles' area."""
        frame, views = self._views.next()
        posed = self._rest.posed(frame, self._smooth.offsets)
        vertices = mi.Float(posed.ravel())
        dr.enable_grad(vertices)
        self._surface.set_vertices(vertices)
        texture = self._optimizer["texture"]
        self._surface.set_texture(srgb_to_linear(texture))
        layers = [
            self._surface.layers(camera, TRAIN_SPP, self._sampler_seed(index, views), rectangle)
            for index, (camera, rectangle, _) in enumerate(views)
        ]
        targets = [np.dstack([truth, self._views.coverage(c, frame)]) for c, _, truth in views]
        error, adjoints = _image_loss(layers, targets, self._views.area * len(views))
        moved = np.zeros_like(posed, dtype=np.float64)
        for (camera, rectangle, _), adjoint in zip(views, adjoints, strict=True):
            samples = self._contours.sample(posed, camera, CONTOUR_SAMPLES, self._random)
            if samples is not None:
                moved += contour_gradient(self._surface, posed, camera, samples, adjoint, rectangle)
        pairs = zip(layers, adjoints, strict=True)
        dr.backward(sum((dr.sum(layer.array * adjoint.array) for layer, adjoint in pairs), mi.Float(0)))
        self._step_texture()
        dr.eval(self._seen, self._optimizer["texture"], vertices.grad)
        self._step_offsets(frame, moved + vertices.grad.numpy().reshape(-1, 3))
        self.steps += 1
        return error

    def _step_offsets(self, frame: int, gradient: np.ndarray) -> None:
        smooth = self._smooth
        strain = STRAIN_WEIGHT * smooth.strain()[1]
        smooth.step(self._rest.pull_back(frame, gradient) + strain, self._offset_rate)
        if self.steps % MEND_STEPS == 0:
            if unsound(self._rest.vertices, smooth.offsets, self._faces).any():
                smooth.replace(repair(self._rest.vertices, smooth.offsets, self._faces, self._sound))
            self._sound = smooth.offsets.copy()


def best_offset_rate(
    surface: TexturedSurface, rest: RestFrames, capture: Capture, size: int, rate: float, seed: int
) -> tuple[float, dict[str, float], float]:
    """The rate of `OFFSET_RATES` with the lowest training loss, found as `mesh_fit.best_rate` finds the texture's.

    Returns the rate, the loss of each by the rate as text, and the seconds that it took.
    """
    start = time.perf_counter()
    chosen = mesh_fit.sweep_frames(capture)
    losses = {
        offset_rate: OffsetFit(surface, rest, capture, size, rate, offset_rate, seed, chosen).for_steps(
            mesh_fit.SWEEP_STEPS
        )
        for offset_rate in OFFSET_RATES
    }
    best = min(losses, key=lambda offset_rate: losses[offset_rate])
    return best, {f"{key:g}": loss for key, loss in losses.items()}, time.perf_counter() - start


def _image_loss(
    layers: Sequence[mi.TensorXf], targets: Sequence[np.ndarray], area: float
) -> tuple[float, list[mi.TensorXf]]:
    """Squared error of the images by `area`, and the whole loss's gradient with respect to each of the layers.

    Args:
        layers: of each view (h, w, 4), linear radiance and coverage.
        targets: of each view (h, w, 5), sRGB, mask, and whether the mask is certain.
        area: pixels.
    """
    leaves = [mi.TensorXf(dr.detach(layer)) for layer in layers]
    dr.enable_grad(leaves)
    error, coverage = mi.Float(0), mi.Float(0)
    for leaf, target in zip(leaves, targets, strict=True):
        truth = mi.TensorXf(target)
        error += dr.sum(dr.square(linear_to_srgb(leaf[:, :, :3]) - truth[:, :, :3]), axis=None).array
        coverage += dr.sum(truth[:, :, 4] * dr.square(leaf[:, :, 3] - truth[:, :, 3]), axis=None).array
    loss = (error / 3 + MASK_WEIGHT * coverage) / area
    dr.backward(loss)
    adjoints = [mi.TensorXf(leaf.grad) for leaf in leaves]
    dr.eval(adjoints, error)
    return float(error[0]) / (3 * area), adjoints


def _pixel_size(capture: Capture) -> float:
    """The side of a pixel of the training cameras at the body's distance, metres; the mean over the cameras."""
    frame = capture.splits["train"].frames[0]
    centre = capture.poses.vertices[capture.poses.index(frame)].mean(axis=0)
    cameras: list[Camera] = [capture.cameras[name] for name in capture.splits["train"].cameras]
    return float(np.mean([np.linalg.norm(camera.position - centre) / camera.fl_x for camera in cameras]))
