"""Training masks for the outlines' fit: a few frames at a time, in images that are no larger than the fit
needs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError

Views = dict[int, list[tuple[Camera, np.ndarray]]]
"""For each frame its pinhole cameras, and (h, w) float32 mattes in [0, 1]."""

MOST_FRAMES = 24
"""Training frames that are read, evenly spaced."""

FRAMES, CAMERAS = 6, 4
"""Frames a round, and cameras a frame."""

PIXEL = 5e-3
"""Metres at the body: images with pixels of half that size or less are reduced."""


class OutlineViews:
    """Masks of the `train` split, read when first used.

    Args:
        capture: the capture.
        seed: of the order of frames and cameras.

    Attributes:
        frames: the frames that are read.

    Raises:
        InputError: the capture has no training images.
    """

    def __init__(self, capture: Capture, seed: int) -> None:
        split = capture.splits["train"]
        if not split.frames or not split.cameras:
            raise InputError(f"{capture.path}: splits.train", "no cameras or no frames",
                             "at least one of each")
        chosen = np.linspace(0, len(split.frames) - 1, MOST_FRAMES).round().astype(int)
        self.frames = [split.frames[index] for index in np.unique(chosen)]
        self._capture = capture
        self._names = split.cameras
        self._random = np.random.default_rng([seed, 3])
        self._order: list[int] = []
        self._read: dict[tuple[str, int], tuple[Camera, np.ndarray]] = {}

    def next(self) -> Views:
        """The views of a round. Frames come in shuffled passes, cameras by chance."""
        while len(self._order) < FRAMES:
            self._order += self._random.permutation(len(self.frames)).tolist()
        rows, self._order = self._order[:FRAMES], self._order[FRAMES:]
        views: Views = {}
        for row in sorted(set(rows)):
            names = self._random.permutation(len(self._names))[:CAMERAS]
            views[self.frames[row]] = [self.view(self._names[index], self.frames[row]) for index in names]
        return views

    def every(self, most: int) -> Views:
        """Up to `most` of the frames, evenly spaced, with up to 2 · `CAMERAS` cameras each."""
        rows = np.unique(np.linspace(0, len(self.frames) - 1, most).round().astype(int))
        columns = np.unique(np.linspace(0, len(self._names) - 1, 2 * CAMERAS).round().astype(int))
        return {self.frames[row]: [self.view(self._names[column], self.frames[row]) for column in columns]
                for row in rows}

    def view(self, name: str, frame: int) -> tuple[Camera, np.ndarray]:
        """A camera and its matte (h, w), both reduced by the same whole factor where pixels are small."""
        if (name, frame) not in self._read:
            capture = self._capture
            camera, matte = capture.cameras[name], capture.matte(name, frame)
            centre = capture.poses.vertices[capture.poses.index(frame)].mean(axis=0)
            pixel = float(np.linalg.norm(camera.position - centre)) / camera.fl_x
            self._read[name, frame] = reduced(camera, matte, max(int(PIXEL / pixel), 1))
        return self._read[name, frame]


def reduced(camera: Camera, matte: np.ndarray, factor: int) -> tuple[Camera, np.ndarray]:
    """The view with blocks of factor × factor pixels in place of each; rows and columns that fill no block
    are left out.
    """
    h, w = (size // factor for size in matte.shape)
    blocks = matte[: h * factor, : w * factor].reshape(h, factor, w, factor)
    cut = replace(camera, w=w * factor, h=h * factor)
    return cut.scaled(w, h), np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)
