"""Batches: rays have the targets, masks and frequencies that they claim."""

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

from ndf_mi.capture.capture import Capture
from ndf_mi.learn.batch import BatchSampler
from ndf_mi.learn.options import TrainingOptions

#: Width of a pixel at the ball, in metres.
PIXEL = 2.5 / 72


def draw(capture, **changes):
    options = dataclasses.replace(TrainingOptions(surface="body", seed=4), **changes)
    return BatchSampler(capture, options, 1, capture.poses)(np.random.default_rng(0))


def distance_to_the_ball(capture, batch):
    """Distance of each ray from the ball's centre, and the ball's radius."""
    vertices = capture.poses.vertices[capture.poses.index(batch.frame)]
    centre, radius = vertices.mean(0), np.linalg.norm(vertices - vertices.mean(0), axis=1).max()
    offset = batch.origin - centre[:, None]
    return np.linalg.norm(offset - (offset * batch.direction).sum(0) * batch.direction, axis=0), radius


def test_rays_hit_what_their_targets_show(capture):
    batch = draw(capture, rays=1000)
    assert batch.origin.shape == batch.direction.shape == batch.target.shape == (3, 1000)
    assert {getattr(batch, name).dtype
            for name in ("origin", "direction", "target", "mask", "mask_valid", "in_box")} == {
        np.dtype(np.float32)}
    np.testing.assert_allclose(np.linalg.norm(batch.direction, axis=0), 1, atol=1e-6)
    distance, radius = distance_to_the_ball(capture, batch)
    assert (distance[batch.mask > 0] < radius + PIXEL).all()
    assert (distance[batch.mask == 0] > radius - 2 * PIXEL).all()
    assert 0.5 < batch.mask.mean() < 0.95
    missing = distance > radius + PIXEL
    background = np.round(capture.background * 255) / 255
    np.testing.assert_allclose(batch.target[:, missing], background[:, None].repeat(missing.sum(), 1),
                               atol=1e-6)


def test_edge_pixels_are_left_out(capture):
    batch = draw(capture, edge_kernel=3, rays=4000)
    target = batch.target[:, batch.mask == 0]
    np.testing.assert_allclose(target, np.broadcast_to(capture.background[:, None], target.shape), atol=3e-3)


def test_masks_are_valid_off_their_edge_only(capture):
    batch = draw(capture, opacity_edge=3, rays=4000)
    distance, radius = distance_to_the_ball(capture, batch)
    off = np.abs(distance - radius)
    assert (batch.mask_valid[off < 0.3 * PIXEL] == 0).all() and (off < 0.3 * PIXEL).sum() > 10
    assert (batch.mask_valid[off > 3 * PIXEL] == 1).all()
    assert (draw(capture, opacity_edge=0).mask_valid == 1).all()


def test_mattes_are_targets_up_to_their_edge(capture, monkeypatch):
    """Opacity is compared with a matte's values on the outline too."""
    masks = draw(capture, rays=4000)
    soften = ndimage.uniform_filter
    monkeypatch.setattr(capture, "matte",
                        lambda name, frame: soften(Capture.matte(capture, name, frame), 3, mode="nearest"))
    mattes = draw(capture, rays=4000)
    assert (mattes.mask_valid == 1).all() and mattes.mask_valid.dtype == np.float32
    on_edge = masks.mask_valid == 0
    assert 0.2 < mattes.mask[(mattes.mask > 0) & (mattes.mask < 1)].mean() < 0.8
    assert (mattes.mask[~on_edge] == masks.mask[~on_edge]).mean() > 0.99
    assert set(np.unique(np.round(mattes.mask * 9, 1))) <= set(range(10))


def test_rays_of_the_box_are_as_frequent_as_its_pixels(capture):
    batch = draw(capture, rays=2000, mask_share=0.25)
    assert batch.in_box.mean() == pytest.approx(0.75, abs=0.01) and (batch.mask[batch.in_box == 0] == 1).all()
    assert batch.mask[batch.in_box == 1].mean() < 0.9
