"""Silhouettes against a convex body's hull, and against the masks of a capture's own renderer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sphere_capture import FRAMES

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.silhouette import Silhouettes, agreement


def test_silhouettes_are_the_hull_of_a_box(
    box_capture: Path, expected_silhouette: Callable[[Camera, np.ndarray], np.ndarray]
) -> None:
    capture = Capture.read(box_capture)
    silhouettes = Silhouettes(capture.body.faces, 8)
    for vertices in capture.poses.vertices[:2]:
        silhouettes.pose(vertices)
        for camera in capture.cameras.values():
            expected = expected_silhouette(camera.pinhole(), vertices)
            # Centres on an edge of the box may fall on either side.
            assert expected.sum() > 50 and (silhouettes.draw(camera) != expected).mean() < 0.005


def of_sphere(capture: Capture, vertices: np.ndarray) -> Silhouettes:
    silhouettes = Silhouettes(capture.body.faces, len(vertices))
    silhouettes.pose(vertices)
    return silhouettes


def test_silhouettes_are_the_masks_of_the_same_mesh(capture: Capture) -> None:
    for row, frame in enumerate(FRAMES[:2]):
        drawn = of_sphere(capture, capture.poses.vertices[row]).draw(capture.cameras["c1"])
        assert drawn.sum() > 300
        differing = np.count_nonzero(drawn != capture.mask("c1", frame))
        assert differing < 0.02 * drawn.sum()  # 64 samples against one


def test_a_ray_that_ends_before_the_mesh_does_not_hit_it(capture: Capture) -> None:
    camera = capture.cameras["c0"]
    silhouettes = of_sphere(capture, capture.poses.vertices[0])
    middle = camera.project(np.zeros((1, 3)))
    nearest = np.linalg.norm(camera.position) - 0.5
    assert silhouettes.hits(camera, middle, np.array([nearest + 0.01])).all()
    assert not silhouettes.hits(camera, middle, np.array([nearest - 0.01])).any()
    assert not silhouettes.hits(camera, np.array([[0.5, 0.5]])).any()


def test_a_mesh_beside_the_camera_is_not_seen_and_one_around_it_everywhere(capture: Capture) -> None:
    camera, sphere = capture.cameras["c0"], capture.body.template
    assert sphere is not None
    right = np.asarray(camera.transform)[:3, 0]
    assert not of_sphere(capture, sphere + 10 * right).draw(camera).any()
    assert of_sphere(capture, 0.1 * sphere + camera.position).draw(camera).all()


def test_agreement_is_the_mean_intersection_over_union() -> None:
    one = np.array([[True, True, False, False]])
    other = np.array([[False, True, True, False]])
    assert agreement([one, one], [other, one]) == pytest.approx((1 / 3 + 1) / 2)
    assert agreement([one], [~one]) == 0
    assert agreement([np.zeros((2, 2), bool)], [np.zeros((2, 2), bool)]) == 1
