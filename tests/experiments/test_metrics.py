"""Metrics against images worked by hand, against scikit-image, and against Mitsuba's ray tracer."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
from skimage.metrics import structural_similarity

from ndf_mi.capture.camera import Camera
from ndf_mi.experiments import metrics
from ndf_mi.learn.options import TrainingOptions


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    truth = rng.random((23, 31, 3), dtype=np.float32)
    return truth, np.clip(truth + rng.normal(0, 0.1, truth.shape), 0, 1).astype(np.float32)


def look_at(origin, target, w=40, h=30, focal=35.0, cx=18.5, cy=16.0):
    back = np.asarray(origin, float) - np.asarray(target, float)
    back /= np.linalg.norm(back)
    right = np.cross([0, 1, 0], back)
    right /= np.linalg.norm(right)
    transform = np.eye(4)
    transform[:3] = np.stack([right, np.cross(back, right), back, np.asarray(origin, float)], axis=1)
    return Camera("c", w, h, focal, focal * 1.1, cx, cy, transform)


def test_psnr_by_hand():
    # Errors 0.1 and 0.3 in one channel of two pixels: MSE = (0.01 + 0.09) / 6 over both, 0.01 / 3 over the
    # first.
    truth, image = np.zeros((1, 2, 3)), np.zeros((1, 2, 3))
    image[0, 0, 0], image[0, 1, 2] = 0.1, 0.3
    assert metrics.psnr(truth, image) == pytest.approx(17.7815125)
    assert metrics.psnr(truth, image, np.array([[True, False]])) == pytest.approx(24.7712125)


def test_matched_colours_undo_an_affine_map_and_nothing_else(pair):
    """An exact map is undone; in general the rest of the error does not correlate with the colours."""
    truth, image = pair
    mask = np.zeros(truth.shape[:2], bool)
    mask[4:20, 3:25] = True
    mixed = truth @ np.array([[0.8, 0.1, 0.0], [0.0, 1.2, 0.05], [0.1, 0.0, 0.7]]) + [0.02, -0.1, 0.05]
    np.testing.assert_allclose(metrics.match_colours(truth, mixed, mask), truth, atol=1e-6)
    rest = (metrics.match_colours(truth, image, mask) - truth)[mask]
    np.testing.assert_allclose(rest.mean(0), 0, atol=1e-10)
    np.testing.assert_allclose(image[mask].T.astype(np.float64) @ rest, 0, atol=1e-7)
    figures = metrics.measure(truth, image, mask)
    assert figures[metrics.MATCHED] == pytest.approx(-10 * math.log10((rest**2).mean()))
    assert figures[metrics.MATCHED] > figures["box_psnr"]


def test_matched_colours_of_one_colour_are_the_truths_mean(pair):
    mask = np.ones(pair[0].shape[:2], bool)
    matched = metrics.match_colours(pair[0], np.full_like(pair[0], 0.5), mask)
    np.testing.assert_allclose(matched, np.broadcast_to(pair[0].mean((0, 1)), matched.shape), atol=1e-6)


def test_temporal_psnr_by_hand():
    # One row of three pixels, one channel; the third pixel is outside the box.
    #   truth  0.2 0.5 0.0  →  0.4 0.5 1.0    change +0.2  0.0
    #   image  0.3 0.5 0.9  →  0.3 0.4 0.0    change  0.0 −0.1
    # Errors of the change −0.2 and −0.1: mean square (0.04 + 0.01) / 2 = 0.025, 16.0206 dB.
    truth = (np.array([[[0.2], [0.5], [0.0]]]), np.array([[[0.4], [0.5], [1.0]]]))
    image = (np.array([[[0.3], [0.5], [0.9]]]), np.array([[[0.3], [0.4], [0.0]]]))
    mask = np.array([[True, True, False]])
    assert metrics.temporal_psnr(truth, image, mask) == pytest.approx(16.0205999)
    # A picture that stands still has the truth's change as its error: 0.04 / 2 = 0.02, 16.9897 dB.
    assert metrics.temporal_psnr(truth, (image[0], image[0]), mask) == pytest.approx(16.9897000)
    # An error that stays where it is does not flicker: the same 0.25 on both frames (exact in binary).
    offset = tuple(side + 0.25 for side in (truth[0] * 0, truth[0] * 0 + 0.5))
    assert metrics.temporal_psnr((truth[0] * 0, truth[0] * 0 + 0.5), offset, mask) == math.inf


def test_box_figures_by_hand():
    # 8 × 9 pixels, grey. The box is rows 0–6, columns 1–7: exactly one SSIM window. Truth 0.5 in it, image
    # 0.7; outside, the
    # truth is 0 and the image 1, which only whole-image figures may see.
    truth, image, mask = np.zeros((8, 9, 3)), np.ones((8, 9, 3)), np.zeros((8, 9), bool)
    mask[:7, 1:8] = True
    truth[mask], image[mask] = 0.5, 0.7
    figures = metrics.measure(truth, image, mask)
    # Box: MSE 0.04 → 13.9794 dB. Whole: (49 · 0.04 + 23 · 1) / 72 = 24.96 / 72 → 4.6009 dB.
    assert figures["box_psnr"] == pytest.approx(13.9794001)
    assert figures["psnr"] == pytest.approx(4.6008825)
    # Constant windows: (2 · 0.35 + C1) / (0.74 + C1) with C1 = 1e-4 for data_range 1 and 4e-4 for 2.
    assert figures["box_ssim"] == pytest.approx(0.7001 / 0.7401)
    assert figures["box_ssim_range2"] == pytest.approx(0.7004 / 0.7404)
    # Of the whole image's 2 × 3 window centres one window is the box; the mean is over all six.
    windows = [
        metrics.ssim(truth[r : r + 7, c : c + 7], image[r : r + 7, c : c + 7])
        for r in (0, 1)
        for c in (0, 1, 2)
    ]
    assert windows[1] == pytest.approx(0.7001 / 0.7401)
    assert figures["ssim"] == pytest.approx(np.mean(windows))
    # Zeros outside the mask are part of the box's rectangle: with one pixel cut out of the mask both sides
    # have a zero there.
    mask[0, 1] = False
    cut_truth, cut_image = np.full((7, 7, 3), 0.5), np.full((7, 7, 3), 0.7)
    cut_truth[0, 0] = cut_image[0, 0] = 0
    # Means 0.5·48/49 and 0.7·48/49; sample variances 0.5²/49 and 0.7²/49, covariance 0.35/49 (48/49 · 49/48 ·
    # 1/49).
    a, b = 24 / 49, 33.6 / 49
    expected = (2 * a * b + 1e-4) * (0.7 / 49 + 9e-4) / ((a * a + b * b + 1e-4) * (0.74 / 49 + 9e-4))
    assert metrics.ssim(cut_truth, cut_image) == pytest.approx(expected)
    assert metrics.measure(truth, image, mask)["box_ssim"] == pytest.approx(expected)
    assert metrics.measure(truth, image, mask)["box_psnr"] == pytest.approx(13.9794001)


def test_box_mask_by_hand():
    # A camera at z = 2 looking along −z, 4 × 4 pixels, focal length 4: rays have slopes ±1/8 and ±3/8. The
    # body is one point
    # at the origin, so the box is ±5 cm; its face towards the camera is 1.95 m away: half extent 0.0256 in
    # slope, no ray hits.
    transform = np.eye(4)
    transform[2, 3] = 2
    camera = Camera("c", 4, 4, 4.0, 4.0, 2.0, 2.0, transform)
    assert not metrics.box_mask(camera, np.zeros((1, 3))).any()
    # With the corners ±0.2 the box is ±0.25, its near face 1.75 m away: ±0.1429 in slope, the four middle
    # pixels.
    expected = np.zeros((4, 4), bool)
    expected[1:3, 1:3] = True
    corners = np.array([[-0.2, -0.2, -0.2], [0.2, 0.2, 0.2]])
    assert (metrics.box_mask(camera, corners) == expected).all()
    # Without padding ±0.2 at 1.8 m: 0.1111 is below 1/8.
    assert not metrics.box_mask(camera, corners, padding=0.0).any()
    # Moved by 0.45 m along x, the near face reaches from 0.2 to 0.7: slopes 1/8 and 3/8 meet it at 0.219 and
    # 0.656.
    expected = np.zeros((4, 4), bool)
    expected[1:3, 2:4] = True
    assert (metrics.box_mask(camera, corners + [0.45, 0, 0]) == expected).all()


def test_training_and_metrics_share_the_padding():
    corners = np.array([[-0.2, -0.3, -0.2], [0.2, 0.2, 0.2]])
    camera = look_at((0.5, 0.4, 2), (0, 0, 0))
    assert (
        metrics.box_mask(camera, corners) == metrics.box_mask(camera, corners, TrainingOptions().box_padding)
    ).all()


def test_psnr_of_identical_images_is_infinite(pair):
    assert metrics.psnr(pair[0], pair[0]) == math.inf
    assert metrics.average([None, 3.0, 5.0]) == 4.0
    assert metrics.average([None]) is None


def test_ssim_by_hand():
    # One window. Constant images a and b have no variance: (2ab + C1) / (a² + b² + C1).
    a, b = np.full((7, 7, 3), 0.2), np.full((7, 7, 3), 0.6)
    assert metrics.ssim(a, b) == pytest.approx((0.24 + 1e-4) / (0.4 + 1e-4))
    # One bright pixel of 1 against black: mean 1/49, sample variance (1 − 1/49)/48 = 1/49.
    spot = np.zeros((7, 7, 1))
    spot[3, 3] = 1
    expected = 1e-4 * 9e-4 / ((1 / 2401 + 1e-4) * (1 / 49 + 9e-4))
    assert metrics.ssim(np.zeros_like(spot), spot) == pytest.approx(expected)


@pytest.mark.parametrize("data_range", [1.0, 2.0])
def test_ssim_agrees_with_scikit_image(pair, data_range):
    settings = {"channel_axis": 2, "data_range": data_range, "win_size": 7, "use_sample_covariance": True}
    expected = structural_similarity(*pair, **settings)
    assert metrics.ssim(*pair, data_range) == pytest.approx(expected, abs=1e-5)
    mask = np.zeros(pair[0].shape[:2], bool)
    mask[3:15, 5:20] = True
    mask[3, 5] = False
    crops = [np.where(mask[..., None], side, 0)[3:15, 5:20] for side in pair]
    expected = structural_similarity(*crops, **settings)
    assert metrics.box_ssim(*pair, mask, data_range) == pytest.approx(expected, abs=1e-5)


def test_data_range_two_is_higher(pair):
    assert metrics.ssim(*pair, 2.0) > metrics.ssim(*pair, 1.0)


def test_averages_are_of_images():
    # PSNR is averaged in decibels, an image at a time: MSEs 0.01 and 0.0001 are 20 and 40 dB, 30 on average;
    # the PSNR of their
    # mean would be 22.97.
    images = [np.full((7, 7, 3), level) for level in (0.1, 0.01)]
    figures = [metrics.measure(np.zeros((7, 7, 3)), image, np.ones((7, 7), bool)) for image in images]
    assert metrics.average([f["box_psnr"] for f in figures]) == pytest.approx(30)


def test_flip_of_black_against_white_is_the_published_maximum(pair):
    assert metrics.flip_map(pair[0], pair[0]).max() == 0
    grey = metrics.flip_map(np.zeros((64, 64, 3)), np.ones((64, 64, 3)))
    assert grey.shape == (64, 64)
    # The largest error between any two grey levels, given by the colour metric alone: 1 up to its
    # compression.
    assert grey[32, 32] == pytest.approx(0.967, abs=0.01)


@pytest.mark.parametrize("origin", [(2.0, 1.5, 2.5), (0.0, 0.0, 4.0), (-3.0, 0.2, 0.0)])
def test_box_mask_agrees_with_a_ray_traced_cube(origin):
    camera = look_at(origin, (0.1, 0.2, 0.0))
    vertices = np.array([[-0.4, -0.9, -0.2], [0.5, 0.8, 0.3], [0.0, 0.0, 0.0]])
    to_world = mi.ScalarTransform4f().translate([0.05, -0.05, 0.05]).scale([0.5, 0.9, 0.3])
    scene = mi.load_dict({"type": "scene", "box": {"type": "cube", "to_world": to_world}})
    x, y = np.meshgrid(np.arange(camera.w) + 0.5, np.arange(camera.h) + 0.5)
    local = np.stack([(x - camera.cx) / camera.fl_x, (camera.cy - y) / camera.fl_y, -np.ones_like(x)], -1)
    directions = (local @ camera.transform[:3, :3].T).reshape(-1, 3).T.astype(np.float32)
    ray = mi.Ray3f(mi.Point3f(camera.transform[:3, 3].astype(np.float32)), mi.Vector3f(directions))
    hits = np.array(scene.ray_test(ray))
    mask = metrics.box_mask(camera, vertices)
    assert 0.05 < mask.mean() < 0.95
    assert (mask.ravel() != hits).sum() <= 1


def test_box_behind_the_camera_and_around_it():
    vertices = np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
    assert not metrics.box_mask(look_at((0, 0, 3), (0, 0, 6)), vertices).any()
    assert metrics.box_mask(look_at((0, 0, 0), (0, 0, 6)), vertices).all()


def test_measure_without_a_box_in_sight(pair):
    figures = metrics.measure(*pair, np.zeros(pair[0].shape[:2], bool))
    assert set(figures) == set(metrics.IMAGE_METRICS)
    assert figures["box_psnr"] is None and figures["box_ssim"] is None and figures["box_flip"] is None
    assert figures["psnr"] == pytest.approx(metrics.psnr(*pair))


def test_measure_over_the_whole_image_is_the_box(pair):
    figures = metrics.measure(*pair, np.ones(pair[0].shape[:2], bool))
    assert figures["box_psnr"] == figures["psnr"]
    assert figures["box_ssim"] == figures["ssim"]


def test_mismatches_are_refused(pair):
    with pytest.raises(ValueError, match="shapes"):
        metrics.psnr(pair[0], pair[1][:5])
    with pytest.raises(ValueError, match="empty"):
        metrics.psnr(*pair, np.zeros(pair[0].shape[:2], bool))
    with pytest.raises(ValueError, match="7×7"):
        metrics.ssim(pair[0][:6], pair[1][:6])


def hunt_lab(rgb: tuple[float, float, float]) -> np.ndarray:
    """Linear sRGB to L*a*b* with FLIP's white, a and b scaled by L/100 for Hunt's effect (Andersson et al.
    2020, section 4.1).
    """
    matrix = np.array(
        [
            [0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
            [0.0193339, 0.1191920, 0.9503041],
        ]
    )
    scaled = (matrix @ np.array(rgb)) / (matrix @ np.ones(3))
    f = np.where(scaled > (6 / 29) ** 3, np.cbrt(scaled), scaled / (3 * (6 / 29) ** 2) + 4 / 29)
    lightness, a, b = 116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])
    return np.array([lightness, 0.01 * lightness * a, 0.01 * lightness * b])


def flip_of_constants(first: tuple[float, float, float], second: tuple[float, float, float]) -> float:
    """FLIP of two images of one colour each, 0 or 1 a channel: no filter changes them and they have no
    features.
    """

    def distance(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
        difference = hunt_lab(a) - hunt_lab(b)
        return float(abs(difference[0]) + np.hypot(*difference[1:])) ** 0.7

    largest = distance((0, 1, 0), (0, 0, 1))
    error, knee = distance(first, second), 0.4 * largest
    return 0.95 * error / knee if error < knee else 0.95 + 0.05 * (error - knee) / (largest - knee)


def test_box_flip_is_of_the_bounding_rectangle_in_the_whole_image():
    """The truth is black; the picture's right half is white. Filters reach a few pixels: further from the
    edge than that, FLIP is that of one colour against another."""
    truth, picture = np.zeros((2, 60, 160, 3), dtype=np.float32)
    picture[:, 80:] = 1
    white = flip_of_constants((0, 0, 0), (1, 1, 1))
    assert 0.9 < white < 1

    def box_flip(*pixels: tuple[int, int]) -> float | None:
        mask = np.zeros((60, 160), dtype=bool)
        mask[tuple(np.transpose(pixels))] = True
        return metrics.measure(truth, picture, mask)["box_flip"]

    # Two corners of the mask span a rectangle; what lies between them counts, mask or not.
    assert box_flip((5, 3), (40, 40)) == pytest.approx(0, abs=1e-4)
    assert box_flip((5, 120), (40, 155)) == pytest.approx(white, abs=2e-3)
    # A rectangle of 20 rows and 110 columns over the edge: its ends are known, its middle of 60 columns is
    # the same wherever it ends.
    middle = box_flip((20, 50), (39, 109))
    assert box_flip((20, 50), (39, 159)) == pytest.approx((60 * middle + 50 * white) / 110, abs=2e-3)
    assert box_flip((20, 0), (39, 109)) == pytest.approx(60 * middle / 110, abs=2e-3)
    # FLIP is taken of the whole image: the white beside this rectangle of black reaches into it.
    assert box_flip((20, 66), (39, 79)) > 1e-3
