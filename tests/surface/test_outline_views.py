"""Which masks a round sees, and views of reduced size."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest

from ndf_mi.capture.document import Split
from ndf_mi.errors import InputError
from ndf_mi.surface.outline_views import CAMERAS, FRAMES, MOST_FRAMES, OutlineViews, reduced


class Recorded:
    """A capture that notes which mattes are read."""

    def __init__(self, capture, cameras: int, frames: int) -> None:
        self.path, self.body = capture.path, capture.body
        names = tuple(f"c{index}" for index in range(cameras))
        self.cameras = {name: dataclasses.replace(capture.cameras["c0"], name=name) for name in names}
        self.splits = {"train": Split(names, tuple(range(frames)))}
        zeros = np.zeros((frames, 3))
        self.poses = dataclasses.replace(
            capture.poses, frames=np.arange(frames), pose=zeros[:, None], root_rotation=zeros,
            vertices=np.repeat(capture.poses.vertices[:1], frames, axis=0), translation=zeros)
        self.read: list[tuple[str, int]] = []

    def matte(self, camera, frame):
        self.read.append((camera, frame))
        return np.ones((48, 48), np.float32)


def test_rounds_pass_over_the_frames_and_read_each_mask_once(capture):
    recorded = Recorded(capture, 6, 100)
    views = OutlineViews(recorded, 0)
    assert len(views.frames) == MOST_FRAMES and views.frames[0] == 0 and views.frames[-1] == 99
    rounds = [views.next() for _ in range(2 * MOST_FRAMES // FRAMES)]
    assert all(len(seen) == CAMERAS for found in rounds for seen in found.values())
    assert all(len(found) == FRAMES for found in rounds)
    times = np.unique([frame for found in rounds for frame in found], return_counts=True)[1]
    np.testing.assert_array_equal(times, 2)
    assert len(recorded.read) == len(set(recorded.read))
    again = OutlineViews(Recorded(capture, 6, 100), 0)
    assert [list(again.next()) for _ in rounds] == [list(found) for found in rounds]
    every = views.every(3)
    assert list(every) == [views.frames[0], views.frames[12], views.frames[-1]] and len(every[0]) == 6


def test_few_frames_are_all_seen(capture):
    assert set(OutlineViews(Recorded(capture, 1, 2), 0).next()) == {0, 1}


def test_a_reduced_view_sees_the_same(capture):
    camera = dataclasses.replace(capture.cameras["c0"], w=50, h=47)
    matte = np.random.default_rng(0).random((47, 50), dtype=np.float32)
    smaller, image = reduced(camera, matte, 3)
    assert (smaller.w, smaller.h) == (16, 15) and image.shape == (15, 16)
    assert image[2, 4] == pytest.approx(matte[6:9, 12:15].mean())
    point = np.array([[0.2, -0.1, 0.3]])
    np.testing.assert_allclose(smaller.project(point), camera.project(point) / 3)
    same, whole = reduced(camera, matte, 1)
    assert same == camera
    np.testing.assert_array_equal(whole, matte)


def test_a_capture_without_training_images(capture):
    changed = copy.copy(capture)
    changed.splits = {"train": Split((), ())}
    with pytest.raises(InputError, match=r"splits\.train.*no cameras"):
        OutlineViews(changed, 0)
