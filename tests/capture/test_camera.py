"""The camera's three faces (project, rays, sensor) against each other, Mitsuba's render and OpenCV's
formula.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ndf_mi.capture.camera import Camera, box_pixels, pixel_rays
from ndf_mi.capture.images import undistort_image, undistort_matte
from ndf_mi.mitsuba_mesh import make_mesh


def turned_camera(**changes: object) -> Camera:
    """A camera off axis in every respect: turned, shifted, principal point away from the middle, not
    square.
    """
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("yxz", [35, -12, 8], degrees=True).as_matrix()
    transform[:3, 3] = [1.9, 0.7, 2.6]
    camera = Camera("turned", 96, 72, 110.0, 110.0, 55.5, 29.25, transform)
    return replace(camera, **changes)  # type: ignore[arg-type]


def points_in_view(camera: Camera, count: int = 200) -> np.ndarray:
    """World points at random pixels and depths of 2 to 5 m, made by inverting the projection by hand."""
    random = np.random.default_rng(0)
    pixels = random.uniform([0, 0], [camera.w, camera.h], (count, 2))
    depth = random.uniform(2, 5, (count, 1))
    local = np.concatenate([(pixels - [camera.cx, camera.cy]) / [camera.fl_x, -camera.fl_y],
                            -np.ones((count, 1))], 1)
    return (local * depth) @ camera.transform[:3, :3].T + camera.transform[:3, 3]


def test_a_point_on_the_axis_lands_on_the_principal_point() -> None:
    camera = turned_camera()
    ahead = camera.transform[:3, 3] - 3 * camera.transform[:3, 2]
    np.testing.assert_allclose(camera.project(ahead[None]), [[55.5, 29.25]], atol=1e-9)


def test_right_and_up_in_the_world_are_right_and_up_in_the_image() -> None:
    camera = Camera("plain", 64, 64, 64.0, 64.0, 32.0, 32.0, np.eye(4))
    right, up, behind = camera.project(np.array([[0.5, 0, -2], [0, 0.5, -2], [0, 0, 2.0]]))
    np.testing.assert_allclose(right, [48, 32])
    np.testing.assert_allclose(up, [32, 16])
    assert np.isnan(behind).all()


def test_rays_go_through_the_points_that_project_to_their_pixels() -> None:
    camera = turned_camera(fl_y=97.0)
    points = points_in_view(camera)
    rays = camera.rays(mi.Point2f(camera.project(points).T.astype(np.float32)))
    origin, direction = np.array(rays.o).T, np.array(rays.d).T
    to_point = points - origin
    distance = np.linalg.norm(np.cross(to_point, direction), axis=1)
    assert distance.max() < 1e-5 * 10
    assert (np.sum(to_point * direction, axis=1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("crop", [None, (10, 20, 40, 30)])
def test_the_sensor_puts_pixels_where_project_says(crop: tuple[int, int, int, int] | None) -> None:
    """Renders a tilted triangle and compares its silhouette with the projected corners', scanned by hand."""
    camera = turned_camera()
    corners = points_in_view(camera, 3)
    scene: dict = {"type": "scene", "integrator": {"type": "direct"},
                   "sensor": camera.sensor(spp=64, crop=crop)}
    scene["mesh"] = make_mesh("triangle", corners, np.array([[0, 1, 2]]))
    covered = np.array(mi.render(mi.load_dict(scene)))[..., 3]

    sub = (np.arange(8) + 0.5) / 8
    x, y = np.meshgrid((np.arange(camera.w)[:, None] + sub).ravel(),
                       (np.arange(camera.h)[:, None] + sub).ravel())
    a, b, c = camera.project(corners)
    sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) > 0 for p, q in ((a, b), (b, c), (c, a))]
    inside = (sides[0] & sides[1] & sides[2]) | ~(sides[0] | sides[1] | sides[2])
    expected = inside.reshape(camera.h, 8, camera.w, 8).mean(axis=(1, 3))
    if crop is not None:
        left, top, width, height = crop
        expected = expected[top : top + height, left : left + width]
    assert expected.mean() > 0.02
    assert np.abs(covered - expected).max() < 0.25
    assert abs(covered.mean() - expected.mean()) < 2e-3


def test_sensor_refuses_what_perspective_cannot_express() -> None:
    with pytest.raises(ValueError, match="pinhole"):
        turned_camera(fl_y=97.0).sensor()
    with pytest.raises(ValueError, match="pinhole"):
        turned_camera(distortion=(0.1, 0, 0, 0, 0)).sensor()
    with pytest.raises(ValueError, match="pinhole"):
        turned_camera(distortion=(0.1, 0, 0, 0, 0)).rays(mi.Point2f(1, 1))


def test_scaled_keeps_the_view() -> None:
    camera = turned_camera()
    points = points_in_view(camera)
    np.testing.assert_allclose(camera.scaled(48, 144).project(points), camera.project(points) * [0.5, 2],
                               atol=1e-9)


def test_one_kernel_serves_every_camera() -> None:
    pixels = mi.Point2f(dr.opaque(mi.Float, 3, (16,)), dr.opaque(mi.Float, 4, (16,)))

    def launches(camera: Camera) -> None:
        dr.eval(camera.rays(pixels))

    launches(turned_camera())
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        launches(turned_camera(cx=12.0, fl_x=80.0))
        history = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert history and all(kernel["cache_hit"] for kernel in history)


DISTORTION = (-0.21, 0.09, -0.015, 0.004, -0.003)


def undistort_by_iteration(seen: np.ndarray, k: tuple[float, ...]) -> np.ndarray:
    """OpenCV's undistortPoints: the fixed point of x = (x' - tangential(x)) / radial(x)."""
    k1, k2, k3, p1, p2 = k
    x, y = seen.T
    for _ in range(100):
        r2 = x**2 + y**2
        scale = 1 / (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3)
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        dy = p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        x, y = (seen[:, 0] - dx) * scale, (seen[:, 1] - dy) * scale
    return np.stack([x, y], 1)


def test_distortion_is_inverted_by_opencv_s_iteration() -> None:
    camera = turned_camera(distortion=DISTORTION)
    points = points_in_view(camera)
    ideal = replace(camera, distortion=(0.0,) * 5).project(points)
    seen = (camera.project(points) - [camera.cx, camera.cy]) / [camera.fl_x, camera.fl_y]
    back = undistort_by_iteration(seen, DISTORTION) * [camera.fl_x, camera.fl_y] + [camera.cx, camera.cy]
    np.testing.assert_allclose(back, ideal, atol=1e-6)
    assert np.abs(camera.project(points) - ideal).max() > 1


def test_undistortion_moves_a_blob_to_where_the_pinhole_camera_sees_it() -> None:
    camera = turned_camera(fl_y=112.0, distortion=DISTORTION)
    point = points_in_view(camera.pinhole(), 40)
    pixels = camera.pinhole().project(point)
    inner = point[((pixels > 8) & (pixels < [camera.w - 8, camera.h - 8])).all(1)][:1]
    rows, columns = np.mgrid[0 : camera.h, 0 : camera.w] + 0.5
    at = camera.project(inner)[0]
    blob = np.exp(-((columns - at[0]) ** 2 + (rows - at[1]) ** 2) / 8)
    image = undistort_image(np.repeat(blob[..., None], 3, 2), camera, np.zeros(3))[..., 0]
    found = np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()
    np.testing.assert_allclose(found, camera.pinhole().project(inner)[0], atol=0.1)
    mask = undistort_matte((blob > 0.5).astype(np.float32), camera) > 0
    centre = [columns[mask].mean(), rows[mask].mean()]
    np.testing.assert_allclose(centre, camera.pinhole().project(inner)[0], atol=0.5)


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
