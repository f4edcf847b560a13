"""Training images in shuffled passes over the frames, cut to the rectangle that the body can cover."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.surface.posed_mesh import Rectangle, View

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
        smallest = self._largest({frame: _bounds(capture, self._cameras, frame, 0.0) for frame in chosen})
        self.area = float(np.mean([np.prod(np.minimum(smallest, [c.w, c.h])) for c in self._cameras]))
        corners = {frame: _bounds(capture, self._cameras, frame, margin) for frame in chosen}
        extent = self._largest(corners)
        self._views: dict[tuple[int, int], tuple[Rectangle, np.ndarray]] = {}
        self._coverages: dict[tuple[str, int], np.ndarray] = {}
        for frame in chosen:
            for index, camera in enumerate(self._cameras):
                rectangle = _rectangle(camera, corners[frame][index, 0], extent)
                image = np.round(_cut(capture.image(camera.name, frame), rectangle) * 255).astype(np.uint8)
                self._views[index, frame] = rectangle, image
                if masks:
                    coverage = _coverage(capture.mask(camera.name, frame))
                    self._coverages[camera.name, frame] = _cut(coverage, rectangle).copy()

    def mean_colour(self) -> np.ndarray:
        """(3,) the mean sRGB of the performer in the first frame's images."""
        frame = self._frames[0]
        pixels = [self._capture.image(camera.name, frame)[self._capture.mask(camera.name, frame)]
                  for camera in self._cameras]
        return np.concatenate(pixels).mean(axis=0)

    def next(self) -> tuple[int, list[View]]:
        """The next frame, and a view for each of up to four random cameras."""
        if not self._order:
            self._order = self._random.permutation(len(self._frames)).tolist()
        frame = self._frames[self._order.pop()]
        count = min(CAMERAS_A_STEP, len(self._cameras))
        chosen = np.sort(self._random.permutation(len(self._cameras))[:count])
        return frame, [self.view(int(index), frame) for index in chosen]

    def view(self, camera: int, frame: int) -> View:
        """What the camera with this index in the split sees at one of the frames."""
        rectangle, image = self._views[camera, frame]
        return self._cameras[camera], rectangle, image.astype(np.float32) / np.float32(255)

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


def _rectangle(camera: Camera, low: np.ndarray, extent: np.ndarray) -> Rectangle:
    """The rectangle of this extent, or the camera's if that is smaller, from `low` on as far as it fits."""
    width, height = (int(value) for value in np.minimum(extent, [camera.w, camera.h]))
    x, y = np.clip(np.floor(low).astype(int) - 1, 0, [camera.w - width, camera.h - height])
    return int(x), int(y), width, height


def _coverage(mask: np.ndarray) -> np.ndarray:
    """(h, w, 2) bool, see `TrainingViews.coverage`."""
    around = np.ones((3, 3), dtype=bool)
    valid = binary_erosion(mask, around, border_value=1) | ~binary_dilation(mask, around)
    return np.stack([mask, valid], axis=-1)


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
