"""Which rays a step sees: pixels of a frame, drawn from the masks and from the body's padded box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Split
from ndf_mi.capture.pixels import box_pixels, pixel_rays
from ndf_mi.errors import InputError
from ndf_mi.learn.options import TrainingOptions


@dataclass(frozen=True)
class RayBatch:
    """R rays of one frame, numpy float32: `origin` and unit `direction` (3, R) in world space, `target` (3, R) sRGB in [0, 1],
    `mask` (R,) 1 on the performer, else 0, `sure` (R,) 1 where the mask says what the opacity is, else 0, and `in_box` (R,) 1 where the
    pixel was drawn from all of the body's box, 0 where from the mask: what is not as frequent as it is in a picture."""

    frame: int
    origin: np.ndarray
    direction: np.ndarray
    target: np.ndarray
    mask: np.ndarray
    sure: np.ndarray
    in_box: np.ndarray


class RaySampler:
    """Draws batches of rays from all cameras of one frame at a time.

    Images are kept in memory as 8-bit values, and so are the indices of the pixels that may be drawn.
    """

    def __init__(self, capture: Capture, split: Split, options: TrainingOptions) -> None:
        self._options = options
        self._frames = split.frames
        self._cameras = [capture.cameras[name] for name in split.cameras]
        if not self._frames or not self._cameras:
            raise InputError(f"{capture.path / 'capture.json'}: splits.train", "no cameras or no frames", "at least one of each")
        self._images: dict[tuple[int, int], np.ndarray] = {}
        self._masks: dict[tuple[int, int], np.ndarray] = {}
        self._sure: dict[tuple[int, int], np.ndarray] = {}
        self._on_mask: dict[tuple[int, int], np.ndarray] = {}
        self._in_box: dict[tuple[int, int], np.ndarray] = {}
        for row, frame in enumerate(self._frames):
            vertices = capture.poses.vertices[capture.poses.index(frame)]
            low, high = vertices.min(0) - options.box_padding, vertices.max(0) + options.box_padding
            for column, name in enumerate(split.cameras):
                camera, key = self._cameras[column], (row, column)
                mask = capture.mask(name, frame)
                allowed = ~_edge(mask, options.edge_kernel)
                box = box_pixels(camera, low, high) & allowed
                if not (mask & allowed).any() or not box.any():
                    raise InputError(f"camera {name}, frame {frame}", "no pixel of the performer in view", "a mask that is not empty")
                self._images[key] = np.round(capture.image(name, frame) * 255).astype(np.uint8).reshape(-1, 3)
                self._masks[key] = mask.ravel()
                self._sure[key] = ~_edge(mask, options.opacity_edge).ravel()
                self._on_mask[key] = np.flatnonzero(mask & allowed).astype(np.uint32)
                self._in_box[key] = np.flatnonzero(box).astype(np.uint32)

    def __call__(self, rng: np.random.Generator) -> RayBatch:
        """A batch of `rays` rays: a random frame, its rays spread evenly over the cameras."""
        options = self._options
        row = int(rng.integers(len(self._frames)))
        counts = np.full(len(self._cameras), options.rays // len(self._cameras))
        counts[: options.rays % len(self._cameras)] += 1
        rng.shuffle(counts)
        parts = [self._draw(rng, (row, column), int(count)) for column, count in enumerate(counts) if count]
        return RayBatch(self._frames[row], *(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))

    def _draw(self, rng: np.random.Generator, key: tuple[int, int], count: int) -> tuple[np.ndarray, ...]:
        on_mask = round(count * self._options.mask_share)
        pixels = np.concatenate([rng.choice(self._on_mask[key], on_mask), rng.choice(self._in_box[key], count - on_mask)])
        camera = self._cameras[key[1]]
        origin, direction = pixel_rays(camera, pixels)
        return (origin.astype(np.float32), direction.astype(np.float32),
                self._images[key][pixels].T.astype(np.float32) / 255, self._masks[key][pixels].astype(np.float32),
                self._sure[key][pixels].astype(np.float32), (np.arange(count) >= on_mask).astype(np.float32))


def _edge(mask: np.ndarray, kernel: int) -> np.ndarray:
    """Pixels around which a square of `kernel` pixels holds both performer and background (dilation minus erosion)."""
    if kernel < 2:
        return np.zeros_like(mask)
    square = np.ones((kernel, kernel), bool)
    return ndimage.binary_dilation(mask, square) & ~ndimage.binary_erosion(mask, square, border_value=1)
