"""Silhouettes against a convex body's hull."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.silhouette import Silhouettes


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
