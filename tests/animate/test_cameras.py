"""Cameras of an animation: the orbit keeps the performer in view, files of cameras are interpolated, and
mistakes are named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ndf_mi.animate.cameras import orbit, read_cameras
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError


def corners(box: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(*box.T, indexing="ij"), -1).reshape(-1, 3)


def walk(count: int = 60) -> np.ndarray:
    """Boxes of a person who walks 5 m ahead, with a jump in the middle."""
    centres = np.linspace([0, 0.9, 0], [0, 0.9, 5], count)
    centres[count // 2 : count // 2 + 5, 1] += 0.4
    half = np.array([0.3, 0.9, 0.3])
    return np.stack([centres - half, centres + half], 1)


def test_orbit_keeps_the_performer_in_the_image() -> None:
    boxes = walk()
    cameras = orbit(boxes, 80, 60, 30.0)
    for box, camera in zip(boxes, cameras, strict=True):
        at = camera.project(corners(box))
        assert (at > 0).all() and (at < [80, 60]).all()
        # Seen about as large throughout: over half the image's height.
        assert np.ptp(at[:, 1]) > 30
    distances = [np.linalg.norm(c.position - b.mean(0)) for b, c in zip(boxes, cameras, strict=True)]
    assert np.ptp(distances) < 0.5
    # Followed without jerks: the jump of 40 cm within one frame moves the camera by millimetres.
    path = np.array([c.position for c in orbit(boxes, 80, 60, 30.0, turns=0)])
    np.testing.assert_allclose(np.diff(path[:, 2]), 5 / 59, atol=1e-6)
    assert np.abs(np.diff(path[:, 1])).max() < 0.02


def test_orbit_goes_round() -> None:
    boxes = np.repeat(walk(2)[:1], 8, 0)
    centre = boxes[0].mean(0)
    for options, want in (({}, 45.0), ({"turns": -0.5}, -22.5), ({"turns": 0.0, "azimuth": 30.0}, 0.0)):
        offsets = [c.position - centre for c in orbit(boxes, 32, 32, 30.0, elevation=10.0, **options)]
        angles = np.unwrap(np.arctan2([o[0] for o in offsets], [o[2] for o in offsets]))
        np.testing.assert_allclose(np.degrees(np.diff(angles)), want, atol=1e-6)
        assert np.degrees(angles[0]) == pytest.approx(options.get("azimuth", 0.0))
        assert np.degrees(np.arcsin(offsets[3][1] / np.linalg.norm(offsets[3]))) == pytest.approx(10)
    assert len(orbit(boxes[:1], 32, 32, 30.0)) == 1


def test_a_captures_camera(capture: Capture) -> None:
    cameras = read_cameras(f"{capture.path}:n0", 4, 30.0)
    assert len(cameras) == 4
    for name in ("transform", "fl_x", "cx", "w"):
        assert np.array_equal(getattr(cameras[3], name), getattr(capture.cameras["n0"], name))
    for source in (f"{capture.path}:n9", str(capture.path), str(capture.path / "capture.json")):
        with pytest.raises(InputError, match="expected one of c0, c1, c2, c3, n0, n1"):
            read_cameras(source, 1, 30.0)


def rigid(angle: float, position: list[float]) -> list[list[float]]:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("y", angle, degrees=True).as_matrix()
    matrix[:3, 3] = position
    return matrix.tolist()


def write(folder: Path, document: Any) -> str:
    (folder / "cameras.json").write_text(json.dumps(document))
    return str(folder / "cameras.json")


def test_keyframes_like_transforms(tmp_path: Path) -> None:
    frames = [{"time": 1, "transform_matrix": rigid(0, [0, 1, 2])},
              {"time": 3, "fl_x": 60, "transform_matrix": rigid(90, [2, 1, 0])}]
    cameras = read_cameras(write(tmp_path, {"w": 40, "h": 30, "fl_x": 50, "cx": 19, "frames": frames}), 9,
                           2.0)
    turns = [Rotation.from_matrix(c.transform[:3, :3]).as_euler("yxz", degrees=True)[0] for c in cameras]
    np.testing.assert_allclose(turns, [0, 0, 0, 22.5, 45, 67.5, 90, 90, 90], atol=1e-9)
    np.testing.assert_allclose([c.position for c in cameras[2:7]], np.linspace([0, 1, 2], [2, 1, 0], 5),
                               atol=1e-12)
    np.testing.assert_allclose([c.fl_x for c in cameras[2:7]], [50, 52.5, 55, 57.5, 60])
    assert {(c.w, c.h, c.cx, c.cy) for c in cameras} == {(40, 30, 19, 15)}


def test_a_camera_path_is_spread_over_the_animation(tmp_path: Path) -> None:
    path = [{"camera_to_world": np.array(rigid(a, [a, 0, 0])).ravel().tolist(), "fov": 90}
            for a in (0, 30, 60)]
    cameras = read_cameras(write(tmp_path, {"render_width": 64, "render_height": 32, "camera_path": path}), 5,
                           30.0)
    np.testing.assert_allclose([c.position[0] for c in cameras], [0, 15, 30, 45, 60])
    assert cameras[0].fl_x == pytest.approx(16) and (cameras[0].cx, cameras[0].cy) == (32, 16)
    one = read_cameras(write(tmp_path, {"render_width": 64, "render_height": 32, "camera_path": path[:1]}), 3,
                       30.0)
    assert len(one) == 3
    assert len(read_cameras(write(tmp_path, {"render_width": 64, "render_height": 32, "camera_path": path}),
                            1, 30.0)) == 1


GOOD = {"w": 40, "h": 30, "fl_x": 50, "transform_matrix": rigid(0, [0, 0, 0])}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], "a list; expected an object"),
        ({}, "no list frames"),
        ({"frames": []}, "no list frames"),
        ({"frames": [3]}, r"frames\[0\]: found a int"),
        ({"frames": [GOOD | {"w": 0}]}, r"frames\[0\].w: found 0"),
        ({"frames": [GOOD | {"w": 1.5}]}, "whole number of pixels"),
        ({"frames": [GOOD | {"fl_x": 10**400}]}, "fl_x: found 1000.*; expected a finite number"),
        ({"frames": [GOOD | {"transform_matrix": [10**400] * 16}]}, "4 x 4 numbers"),
        ({"frames": [GOOD | {"fl_x": None}]}, "fl_x: found nothing"),
        ({"frames": [GOOD | {"transform_matrix": [1, 2]}]}, "4 x 4 numbers"),
        ({"frames": [GOOD | {"transform_matrix": (2 * np.eye(4)).tolist()}]}, "rigid motion"),
        ({"frames": [GOOD, GOOD | {"time": 1}]}, r"frames\[1\].time: .* a time in every keyframe or in none"),
        ({"frames": [GOOD | {"time": 1}, GOOD | {"time": 1}]}, r"frames\[1\].time: found 1"),
        ({"frames": [GOOD, GOOD | {"w": 42}]}, "42 x 30 pixels; expected 40 x 30"),
        ({"render_width": 4, "render_height": 4,
          "camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": 180}]}, "below 180"),
    ],
)
def test_refuses(tmp_path: Path, document: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_cameras(write(tmp_path, document), 2, 30.0)


def test_refuses_what_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="orbit, CAPTURE:NAME, or a JSON file"):
        read_cameras("orbits", 2, 30.0)
    for text in ("{", "[" * 100_000):
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(InputError, match="cannot be read as JSON"):
            read_cameras(str(tmp_path / "c.json"), 2, 30.0)
    with pytest.raises(InputError, match="no such f"):
        read_cameras(str(tmp_path / "nowhere") + ":c0", 2, 30.0)
