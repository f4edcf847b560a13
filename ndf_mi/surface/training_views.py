"""Training images in shuffled passes over the frames, cut to the rectangle that the body can cover."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.surface.textured import Rectangle

CAMERAS_A_STEP = 4


class TrainingViews:
    """The `train` split, frame by frame.

    All images are decoded when this is made and kept as 8-bit values, like those that the field trains on. No
    time of training is spent on reading files. Pixels that were resampled because their camera has distortion
    are rounded.

    All images of one camera are cut to rectangles of one size, so that kernels are compiled once. Cameras of
    one size have rectangles of one size.

    Args:
        capture: the capture.
        seed: of the order.
        frames: a subset of the training frames; all by default.
        margin: metres around the body that the rectangles show.
        masks: whether `coverage` will be called.

    Attributes:
        frames: the number of frames in a pass.
        area: pixels of a rectangle without the margin, the mean over the cameras.

    Raises:
        InputError: the capture has no training images, or a training camera does not see the body.
    """

    def __init__(self, capture: Capture, seed: int, frames: Sequence[int] | None = None, margin: float = 0.0,
                 masks: bool = False) -> None:
        split = capture.splits["train"]
        chosen = split.frames if frames is None else tuple(frames)
        if not chosen or not split.cameras:
            raise InputError(f"{capture.path}: splits.train", "no cameras or no frames",
                             "at least one of each")
        self._capture = capture
        self._cameras = [capture.cameras[name] for name in split.cameras]
        self._frames = chosen
        self.frames = len(chosen)
        self._random = np.random.default_rng(seed)
        self._order: list[int] = []
        bare = {frame: _bounds(capture, self._cameras, frame, 0.0) for frame in chosen}
        smallest = self._largest(bare)
        self.area = float(np.mean([np.prod(np.minimum(smallest, [c.w, c.h])) for c in self._cameras]))
        self._corners = {frame: _bounds(capture, self._cameras, frame, margin) for frame in chosen}
        self._extent = self._largest(self._corners)
        pairs = [(index, frame) for frame in chosen for index in range(len(self._cameras))]
        self._images = {pair: self._image(*pair) for pair in pairs}
        self._coverages = {(self._cameras[index].name, frame): self._coverage(index, frame)
                           for index, frame in pairs if masks}

    def mean_colour(self) -> np.ndarray:
        """(3,) the mean sRGB of the performer in the first frame's images."""
        frame = self._frames[0]
        pixels = [self._capture.image(camera.name, frame)[self._capture.mask(camera.name, frame)]
                  for camera in self._cameras]
        return np.concatenate(pixels).mean(axis=0)

    def next(self) -> tuple[int, list[tuple[Camera, Rectangle, np.ndarray]]]:
        """The next frame, and a view for each of up to four random cameras.

        A view is a camera, a rectangle of its image, and (h, w, 3) float32 sRGB in that rectangle.
        """
        if not self._order:
            self._order = self._random.permutation(len(self._frames)).tolist()
        frame = self._frames[self._order.pop()]
        count = min(CAMERAS_A_STEP, len(self._cameras))
        chosen = np.sort(self._random.permutation(len(self._cameras))[:count])
        return frame, [self._view(int(index), frame) for index in chosen]

    def coverage(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 2) float32 in the view's rectangle: 1 on the performer's mask; 1 where the mask is valid.

        Masks are not valid along their edges, within 3 × 3 pixels of both sides: such pixels are covered in
        part.
        """
        return self._coverages[camera.name, frame].astype(np.float32)

    def _largest(self, corners: dict[int, np.ndarray]) -> np.ndarray:
        """(2,) width and height of the largest rectangle, with a pixel more on each side.

        Args:
            corners: (cameras, low and high, 2) pixel coordinates for each frame.
        """
        extent = np.max([box[:, 1] - box[:, 0] for box in corners.values()], axis=(0, 1))
        if not np.isfinite(extent).all():
            raise InputError(self._capture.path, "a body behind a training camera",
                             "training cameras that see the body")
        return np.ceil(extent).astype(int) + 2

    def _view(self, index: int, frame: int) -> tuple[Camera, Rectangle, np.ndarray]:
        image = self._images[index, frame].astype(np.float32) / np.float32(255)
        return self._cameras[index], self._rectangle(index, frame), image

    def _rectangle(self, index: int, frame: int) -> Rectangle:
        camera = self._cameras[index]
        width, height = (int(value) for value in np.minimum(self._extent, [camera.w, camera.h]))
        low = np.floor(self._corners[frame][index, 0]).astype(int) - 1
        x, y = (int(value) for value in np.clip(low, 0, [camera.w - width, camera.h - height]))
        return x, y, width, height

    def _image(self, index: int, frame: int) -> np.ndarray:
        """(h, w, 3) uint8 sRGB in the view's rectangle."""
        image = _cut(self._capture.image(self._cameras[index].name, frame), self._rectangle(index, frame))
        return np.round(image * 255).astype(np.uint8)

    def _coverage(self, index: int, frame: int) -> np.ndarray:
        """(h, w, 2) bool, see `coverage`."""
        mask = self._capture.mask(self._cameras[index].name, frame)
        around = np.ones((3, 3), dtype=bool)
        valid = binary_erosion(mask, around, border_value=1) | ~binary_dilation(mask, around)
        return _cut(np.stack([mask, valid], axis=-1), self._rectangle(index, frame)).copy()


def _cut(image: np.ndarray, rectangle: Rectangle) -> np.ndarray:
    x, y, width, height = rectangle
    return image[y : y + height, x : x + width]


def _bounds(capture: Capture, cameras: Sequence[Camera], frame: int, margin: float) -> np.ndarray:
    """(cameras, 2, 2) the lowest and highest pixel coordinates of the posed body in each camera; NaN if it is
    behind.

    Each side has `margin` metres more, at the distance of the body's nearest point.
    """
    vertices = capture.poses.vertices[capture.poses.index(frame)]
    bounds = []
    for camera in cameras:
        points = camera.project(vertices)
        aside = margin * camera.fl_x / max(-camera.to_camera(vertices)[:, 2].max(), 1e-6)
        bounds.append([points.min(axis=0) - aside, points.max(axis=0) + aside])
    return np.stack(bounds)
