"""Which pixels of damaged masks lose trust, on the ball, whose masks are known."""

import dataclasses

import numpy as np
import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.learn.batch import BatchSampler
from ndf_mi.learn.mask_trust import MaskTrust
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.visual_hull import grown


@pytest.fixture
def trust(capture):
    """Weights for the first camera when its mask is replaced; the image may be too."""
    names = capture.splits["train"].cameras
    number = capture.splits["train"].frames[0]
    vertices = capture.poses.vertices[capture.poses.index(number)]
    weigh = MaskTrust(capture, 0.08)

    def of(change, image=lambda image, mask: image):
        mattes = [capture.matte(name, number) for name in names]
        images = [capture.image(name, number) for name in names]
        mask = mattes[0] >= 0.5
        damaged = change(mask.copy())
        images[0] = image(images[0].copy(), damaged)
        weights = weigh(number, vertices, [capture.cameras[name] for name in names], images,
                        [damaged.astype(np.float32), *mattes[1:]])
        outline = grown(damaged, 1) & ~grown(damaged, -1)
        return weights, damaged != mask, outline

    return of


def recall_and_rest(weights, wrong, outline):
    """Trust lost on wrong pixels, and on the others, of those off the outline."""
    return 1 - weights[0][wrong & ~outline].mean(), 1 - weights[0][~wrong & ~outline].mean()


def composited(capture):
    def over(image, mask):
        image[~mask] = capture.background
        return image
    return over


def with_hole(mask):
    mask[20:27, 20:27] = False
    return mask


def with_block(mask):
    rows, columns = np.nonzero(mask)
    mask[30:42, columns.max() + 1 : columns.max() + 9] = True
    return mask


def test_clean_masks_are_trusted(trust):
    weights, _, _ = trust(lambda mask: mask)
    assert all(each.min() == 1 and each.dtype == np.float32 for each in weights)


@pytest.mark.parametrize(("change", "least"), [
    (lambda mask: grown(mask, -4), 0.95), (lambda mask: grown(mask, 3), 0.75), (with_hole, 0.95),
    (with_block, 0.95),
])
def test_damage_that_the_image_shows_is_found(trust, change, least):
    weights, wrong, outline = trust(change)
    lost, rest = recall_and_rest(weights, wrong, outline)
    assert (wrong & ~outline).sum() > 20 and lost > least and rest < 0.03
    # The other cameras' masks are right.
    assert all((1 - each).mean() < 0.01 for each in weights[1:])


def test_an_object_in_mask_and_image_is_found_by_the_other_cameras(trust):
    """As far as they see where it would be: the ball nearly fills their images."""
    block = np.zeros((48, 48), bool)
    block[2:10, 36:46] = True

    def painted(image, mask):
        image[block] = 0.9
        return image

    weights, wrong, outline = trust(lambda mask: mask | block, painted)
    lost, rest = recall_and_rest(weights, wrong, outline)
    assert lost > 0.6 and rest < 0.01


def test_a_hole_that_was_cut_into_the_image_too_is_weak_evidence(trust, capture):
    weights, wrong, outline = trust(with_hole, composited(capture))
    doubtful = weights[0][wrong & ~outline]
    assert 0.7 < 1 - doubtful.mean() < 0.8 and (weights[0][~wrong] == 1).all()


def test_a_performer_in_the_backgrounds_colour_is_trusted(trust, capture):
    def dressed(image, mask):
        image[:] = capture.background
        return image

    assert trust(lambda mask: mask, dressed)[0][0].min() == 1


def test_an_image_without_the_captures_background_says_nothing(trust):
    def noisy(image, mask):
        return np.where(mask[..., None], image, np.random.default_rng(0).random(image.shape))

    assert trust(lambda mask: mask, noisy)[0][0].min() == 1


def test_batches_carry_the_trust(capture, monkeypatch):
    first = capture.splits["train"].cameras[0]

    def matte(name, frame):
        found = Capture.matte(capture, name, frame)
        return grown(found > 0, 4).astype(np.float32) if name == first else found

    monkeypatch.setattr(capture, "matte", matte)
    options = TrainingOptions(rays=4000, opacity_edge=0)
    drawn = {on: BatchSampler(capture, dataclasses.replace(options, mask_trust=on), 1, capture.poses)(
        np.random.default_rng(0)) for on in (True, False)}
    assert (drawn[False].mask_valid == 1).all() and 0.01 < (drawn[True].mask_valid == 0).mean() < 0.2
    np.testing.assert_array_equal(drawn[True].mask, drawn[False].mask)
