"""A small capture made by hand: a box of a body before three cameras, silhouettes filled by testing every
pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from ndf_mi.body import Body, Poses
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.document import Document, Split
from ndf_mi.capture.writer import CaptureWriter

FRAMES = (0, 1, 5)
BACKGROUND = (0.25, 0.5, 0.75)


def box_document() -> Document:
    """Cameras a and b at the front and the side, and c, which has distortion and non-square pixels."""
    side = np.array([[0, 0, 1, 4], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
    front = np.eye(4)
    front[2, 3] = 4
    cameras = {"a": Camera("a", 40, 32, 40.0, 40.0, 20.0, 16.0, front),
               "b": Camera("b", 32, 48, 45.0, 45.0, 15.0, 25.0, side),
               "c": Camera("c", 40, 32, 40.0, 41.0, 20.0, 16.0, front, (-0.2, 0.05, 0.0, 0.001, 0.002))}
    splits = {"train": Split(("a", "b"), (0, 1)), "novel_view": Split(("c",), (1,)),
              "novel_pose": Split(("a",), (5,))}
    return Document("box", BACKGROUND, cameras, splits)


def box_body() -> tuple[Body, Poses]:
    box = trimesh.creation.box((0.6, 1.2, 0.4))
    vertices = np.array(box.vertices, dtype=np.float32)
    faces = np.array(box.faces, dtype=np.int32)
    uv = np.random.default_rng(0).uniform(size=(len(vertices), 2)).astype(np.float32)
    shifts = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], dtype=np.float32)
    still = np.zeros((len(FRAMES), 3), dtype=np.float32)
    poses = Poses(np.array(FRAMES, dtype=np.int32), vertices + shifts[:, None], still[:, None].copy(),
                  still.copy(), shifts.copy())
    return Body(faces, uv, faces.copy()), poses


def silhouette(camera: Camera, vertices: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels whose centre lies in the hull of the projected vertices of a convex body."""
    hull = ConvexHull(camera.project(vertices))
    rows, columns = np.mgrid[0 : camera.h, 0 : camera.w] + 0.5
    centres = np.stack([columns, rows], -1)
    return (centres @ hull.equations[:, :2].T + hull.equations[:, 2] < 0).all(-1)


@pytest.fixture
def expected_silhouette() -> Callable[[Camera, np.ndarray], np.ndarray]:
    """``silhouette``, for tests, which cannot import this file."""
    return silhouette


@pytest.fixture
def box_capture(tmp_path: Path) -> Path:
    """The folder of a complete and valid capture."""
    document = box_document()
    body, poses = box_body()
    writer = CaptureWriter(tmp_path / "box", document)
    for name, frame in document.images():
        mask = silhouette(document.cameras[name], poses.vertices[poses.index(frame)])
        image = np.where(mask[..., None], np.array([0.9, 0.2, 0.1]), np.array(BACKGROUND))
        writer.write(name, frame, image, mask)
    writer.finish(body, poses)
    return tmp_path / "box"
