"""Rays through what other cameras see, against what is known of a ball."""

import numpy as np
import pytest

from ndf_mi.capture.camera import Camera, look_at, pixel_rays
from ndf_mi.learn.visual_hull import grown, pixels, seen_by_others

RADIUS, SIZE = 0.5, 96
#: Width of a pixel at the ball, in metres.
PIXEL = 2.5 / 80


def distance(camera):
    """(h, w) distance of each pixel's ray from the origin."""
    origin, direction = pixel_rays(camera, np.arange(SIZE * SIZE))
    along = (origin * direction).sum(0)
    return np.linalg.norm(origin - along * direction, axis=0).reshape(SIZE, SIZE)


@pytest.fixture(scope="module")
def scene():
    """Four cameras around a ball, what they see, and points on it."""
    cameras = []
    for index, angle in enumerate(1.57 * np.arange(4)):
        at = 2.5 * np.array([np.sin(angle), 0.2 * (-1) ** index, np.cos(angle)])
        cameras.append(Camera(f"c{index}", SIZE, SIZE, 80.0, 80.0, 47.0, 49.0, look_at(at, np.zeros(3))))
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1, keepdims=True)
    return cameras, [distance(camera) < RADIUS for camera in cameras], points.astype(np.float32)


def test_points_are_found_in_the_pixels_that_the_camera_projects_them_to(scene):
    camera = scene[0][1]
    points = np.random.default_rng(0).uniform(-2.5, 2.5, (500, 3)).astype(np.float32)
    projected = camera.project(points)
    inside = np.isfinite(projected).all(1) & ((projected >= 0) & (projected < [camera.w, camera.h])).all(1)
    expected = np.floor(projected[inside]) @ [1, camera.w]
    found = pixels(camera, points)
    assert 50 < inside.sum() < 450 and (found[~inside] == camera.w * camera.h).all()
    assert (found[inside] == expected).mean() > 0.99


def test_all_cameras_see_a_ball(scene):
    cameras, masks, points = scene
    for mask, found in zip(masks, seen_by_others(cameras, masks, points, 0.3), strict=True):
        assert found[grown(mask, -2)].all()


def test_one_camera_alone_cannot_add_what_the_others_do_not_see(scene):
    """Three cameras leave at most the intersection of their cones."""
    cameras, masks, points = scene
    seen = seen_by_others(cameras, [np.ones_like(masks[0]), *masks[1:]], points, 0.3)[0]
    away = distance(cameras[0]) > RADIUS * np.sqrt(2) + 3 * PIXEL
    assert not seen[away].any() and seen.any() and away.sum() > 100


def test_an_empty_mask_excludes_the_ball_from_all_other_cameras(scene):
    cameras, masks, points = scene
    seen = seen_by_others(cameras, [np.zeros_like(masks[0]), *masks[1:]], points, 0.3)
    assert seen[0][grown(masks[0], -2)].all() and not any(found.any() for found in seen[1:])


def test_rays_are_not_followed_beyond_the_reach(scene):
    """Where all masks are full, the pixels seen are those whose ray comes within reach of the ball."""
    cameras, masks, points = scene
    full, reach = [np.ones_like(mask) for mask in masks], 0.3
    for camera, found in zip(cameras, seen_by_others(cameras, full, points, reach), strict=True):
        away = distance(camera) - RADIUS
        assert found[away < reach - 6 * PIXEL].all()
        assert not found[away > reach + 15 * PIXEL].any()


def test_masks_grow_and_shrink_by_pixels():
    mask = np.zeros((9, 9), bool)
    mask[3:6, 3:6] = True
    assert grown(mask, 2).sum() == 49 and grown(mask, -1).sum() == 1 and grown(mask, 0) is mask
