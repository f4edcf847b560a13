"""Training views that training starts without: their error shows when the field fits the others too
closely.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import box_pixels, pixel_rays
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters
from ndf_mi.learn.batch import Batch, drawing_box
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.run import Run

MOST_VIEWS = 12
"""Largest number of views that are held back; more would say little more."""
RAYS = 2048
"""Rays of all held-back views together."""
EVERY = 50
"""Held-back rays are rendered after steps whose number is a multiple of this, …"""
SHARE = 1 / 30
"""… and after at least this share of the training since the last time, and at its end."""
TOLERANCE = 1.03
"""Longer training counts as harmless while the error is at most this factor above the least so far."""

View = tuple[int, int]
"""A training image: indices of its frame and of its camera in the training split."""


def choose_views(frames: int, cameras: int, share: float, seed: int) -> tuple[View, ...]:
    """Views to hold back, spread evenly over frames and over cameras.

    With several cameras every frame keeps a view, with one every second frame does.

    Args:
        frames, cameras: how many the training split has.
        share: of the views; the number is rounded, and at most `MOST_VIEWS`.
        seed: of the order of frames and cameras.

    Returns:
        As many different views, none where the share is less than half a view.
    """
    most = frames * (cameras - 1) if cameras > 1 else frames // 2
    count = min(math.floor(share * frames * cameras + 0.5), most, MOST_VIEWS)
    rng = np.random.default_rng([seed, 2])
    rows, columns = rng.permutation(frames), rng.permutation(cameras)
    return tuple((int(rows[i % frames]), int(columns[(i % frames + i // frames) % cameras]))
                 for i in range(count))


class HeldBackRays:
    """Rays of held-back views, drawn once from the box of the performer, in which pixels are as frequent as
    in an image.

    Args:
        run: its poses are those of the reference surface.
        capture: the images.
        options: sampling.
        views: what to draw from, at least one: indices in the training split.
        poses: of the reference surface; by default the run's.

    Attributes:
        batches: one for each view.
    """

    def __init__(self, run: Run, capture: Capture, options: TrainingOptions, views: Sequence[View],
                 poses: Poses | None = None) -> None:
        rng = np.random.default_rng([options.seed, 3])
        split = capture.splits["train"]
        self.batches = [view_rays(run, capture, options, split.cameras[column], split.frames[row],
                                  RAYS // len(views), rng, poses) for row, column in views]

    def error(self, image_error: Callable[[FieldParameters, Batch], float],
              parameters: FieldParameters) -> float:
        """Mean squared error in sRGB of all rays.

        Args:
            image_error: the same of a batch's rays.
        """
        return mean_error(self.batches, image_error, parameters)


def mean_error(batches: Sequence[Batch], image_error: Callable[[FieldParameters, Batch], float],
               parameters: FieldParameters) -> float:
    """Mean of `image_error` over the rays of all batches."""
    errors = [image_error(parameters, batch) for batch in batches]
    return float(np.average(errors, weights=[len(batch.in_box) for batch in batches]))


def view_rays(run: Run, capture: Capture, options: TrainingOptions, camera: str, frame: int, count: int,
              rng: np.random.Generator, poses: Poses | None = None) -> Batch:
    """Rays through different random pixels of the performer's box in one image, without noise: samples lie in
    the middles of their strata.

    Args:
        run: its poses are those of the reference surface.
        camera, frame: of the image.
        count: number of rays, or of the box's pixels if these are fewer.
        poses: used instead of the run's.

    Raises:
        InputError: the camera does not see the box.
    """
    poses = run.poses if poses is None else poses
    lens = capture.cameras[camera]
    box = box_pixels(lens, *drawing_box(capture, poses, frame, options.box_padding))
    if not box.any():
        raise InputError(f"camera {camera}, frame {frame}", "no pixel of the performer in view",
                         "a camera that sees the body")
    pixels = rng.permutation(np.flatnonzero(box))[:count].astype(np.uint32)
    origin, direction = (each.astype(np.float32) for each in pixel_rays(lens, pixels))
    target = capture.image(camera, frame).reshape(-1, 3)[pixels].T.astype(np.float32)
    mask = capture.matte(camera, frame).ravel()[pixels].astype(np.float32)
    ones = np.ones(len(pixels), np.float32)
    candidates = options.samples * run.model.field.preset.sample_factor
    pose = poses.pose[poses.index(frame)].astype(np.float32)
    cameras = capture.splits["train"].cameras
    column = cameras.index(camera) if camera in cameras else len(cameras)
    return Batch(frame, origin, direction, target, mask, ones, ones,
                 np.full(len(pixels) * candidates, 0.5, np.float32), pose.ravel(), edge_active=False,
                 camera=np.full(len(pixels), column, np.uint32))
