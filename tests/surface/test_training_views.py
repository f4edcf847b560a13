"""Training images as a fit sees them."""

from __future__ import annotations

import numpy as np

from ndf_mi.surface.training_views import TrainingViews


def test_images_and_masks_are_the_captures(capture):
    views = TrainingViews(capture, 0, masks=True)
    seen = set()
    for _ in range(views.frames):
        frame, chosen = views.next()
        seen.add(frame)
        for camera, (x, y, w, h), image in chosen:
            whole, mask = capture.image(camera.name, frame), capture.mask(camera.name, frame)
            np.testing.assert_array_equal(image, whole[y : y + h, x : x + w])
            np.testing.assert_array_equal(views.coverage(camera, frame)[..., 0], mask[y : y + h, x : x + w])
    assert seen == set(capture.splits["train"].frames)


def test_rectangles_hold_the_body_and_the_margin(capture):
    bare, wide = TrainingViews(capture, 0), TrainingViews(capture, 0, margin=0.2)
    for views in (bare, wide):
        frame, chosen = views.next()
        for camera, (x, y, w, h), _ in chosen:
            points = camera.project(capture.poses.vertices[capture.poses.index(frame)])
            assert (points >= [x, y]).all() and (points <= [x + w, y + h]).all()
    assert wide.area == bare.area
    assert wide.next()[1][0][1][2] > bare.next()[1][0][1][2]


def test_masks_are_not_valid_along_their_edges(capture):
    views = TrainingViews(capture, 0, masks=True, margin=0.1)
    frame, [(camera, _, _), *_] = views.next()
    mask, valid = np.moveaxis(views.coverage(camera, frame), -1, 0) > 0
    edge = np.zeros_like(mask)
    edge[:, :-1] |= mask[:, :-1] != mask[:, 1:]
    assert edge.any() and not valid[edge].any() and valid.mean() > 0.5
