"""Rays through pixels and masks of boxes, against the camera's own rays and projection."""

import mitsuba as mi
import numpy as np

from ndf_mi.capture.pixels import box_pixels, pixel_rays


def test_pixel_rays_agree_with_the_cameras_own(capture):
    camera = capture.cameras["c1"]
    pixels = np.array([0, 17, camera.w * camera.h - 1])
    _, direction = pixel_rays(camera, pixels)
    y, x = np.divmod(pixels, camera.w)
    ray = camera.rays(mi.Point2f(mi.Float((x + 0.5).astype(np.float32)),
                                 mi.Float((y + 0.5).astype(np.float32))))
    np.testing.assert_allclose(np.array(ray.d), direction, atol=1e-6)
    points = camera.position + 2 * direction.T
    np.testing.assert_allclose(camera.project(points), np.stack([x, y], -1) + 0.5, atol=1e-6)


def test_box_pixels_cover_the_boxs_corners(capture):
    camera = capture.cameras["c0"]
    low, high = np.full(3, -0.3), np.full(3, 0.3)
    mask = box_pixels(camera, low, high)
    corners = np.stack(np.meshgrid(*np.stack([0.9 * low, 0.9 * high], -1)), -1).reshape(-1, 3)
    x, y = np.floor(camera.project(corners)).astype(int).T
    assert mask[y, x].all() and not mask[0].any() and not mask[:, -1].any()
