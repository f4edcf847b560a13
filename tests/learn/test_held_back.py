"""Held-back views: which they are, that training never draws them, and that their error is an image's."""

import dataclasses

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.batch import BatchSampler
from ndf_mi.learn.held_back import MOST_VIEWS, HeldBackRays, choose_views
from ndf_mi.learn.loop import start
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.step import QuadratureStep
from ndf_mi.render.image import ImageRenderer

OPTIONS = TrainingOptions(rays=256, samples=24, seed=4, held_back=0.25)


def test_views_are_spread_over_frames_and_cameras():
    views = choose_views(12, 4, 1 / 6, seed=0)
    assert len(set(views)) == 8 and len({row for row, _ in views}) == 8
    assert sorted(np.bincount([column for _, column in views])) == [2, 2, 2, 2]
    assert choose_views(12, 4, 1 / 6, seed=1) != views == choose_views(12, 4, 1 / 6, seed=0)


@pytest.mark.parametrize(("frames", "cameras", "share", "count"), [
    (12, 4, 0.05, 2), (2, 4, 0.05, 0), (12, 4, 0.0, 0), (400, 4, 0.05, MOST_VIEWS), (2, 2, 0.5, 2),
    (3, 1, 0.5, 1), (1, 1, 0.5, 0), (5, 4, 0.5, 10)])
def test_every_frame_keeps_a_view(frames, cameras, share, count):
    views = choose_views(frames, cameras, share, seed=3)
    assert len(views) == len(set(views)) == count
    lost = np.bincount([row for row, _ in views], minlength=frames) >= cameras
    assert not lost.any() or (cameras == 1 and lost.sum() <= frames / 2)


def test_rays_of_held_back_views_are_never_drawn(capture):
    split = capture.splits["train"]
    held = choose_views(len(split.frames), len(split.cameras), OPTIONS.held_back, OPTIONS.seed)
    assert len(held) == 2
    sampler = BatchSampler(capture, OPTIONS, 1, capture.poses, held)
    rng, seen = np.random.default_rng(0), set()
    eyes = np.array([capture.cameras[name].transform[:3, 3] for name in split.cameras])
    for _ in range(40):
        batch = sampler(rng)
        assert batch.origin.shape == (3, OPTIONS.rays)
        column = np.abs(batch.origin.T[:, None] - eyes).sum(-1).argmin(1)
        seen |= {(split.frames.index(batch.frame), int(each)) for each in set(column)}
    assert seen == {(row, column) for row in range(2) for column in range(4)} - set(held)


def test_without_held_back_views_batches_are_those_of_a_plain_sampler(capture):
    none = choose_views(2, 4, 0.0, 0)
    one, other = (sampler(np.random.default_rng(1)) for sampler in (
        BatchSampler(capture, OPTIONS, 1, capture.poses),
        BatchSampler(capture, OPTIONS, 1, capture.poses, none)))
    np.testing.assert_array_equal(one.origin, other.origin)
    np.testing.assert_array_equal(one.jitter, other.jitter)


def test_the_error_is_that_of_images_over_the_box(capture, tmp_path):
    """Of all of the box's pixels, in an image with as many samples."""
    tiny = dataclasses.replace(preset("tiny"), band_inside=0.08)
    run = start(tmp_path / "run", capture, tiny, OPTIONS).run
    rays = HeldBackRays(run, capture, OPTIONS, [(1, 2)])
    (batch,) = rays.batches
    camera, frame = capture.splits["train"].cameras[2], capture.splits["train"].frames[1]
    assert batch.frame == frame
    image = ImageRenderer(OPTIONS.samples, cutoff=0)(run.posed(frame), capture.cameras[camera])
    error = np.square(image.over(run.background) - capture.image(camera, frame)).mean(-1)
    places = capture.cameras[camera].project((batch.origin + 2 * batch.direction).T)
    x, y = np.floor(places).astype(int).T
    assert len(set(zip(x, y, strict=True))) == len(x) > 500
    np.testing.assert_allclose(capture.image(camera, frame)[y, x].T, batch.target, atol=1e-6)
    found = rays.error(QuadratureStep(run, OPTIONS, None).image_error, run.parameters)
    assert found == pytest.approx(error[y, x].mean(), rel=1e-3)


def test_a_share_out_of_range_is_refused():
    with pytest.raises(InputError, match="held-back"):
        TrainingOptions(held_back=0.6)
    old = OPTIONS.to_dict()
    del old["held_back"]
    assert TrainingOptions.from_dict(old).held_back == 0
