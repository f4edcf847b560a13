"""Plans keep the parts that captures need: a ball in a fixed light, a glossy one, one whose pattern moves,
and one in clothes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sphere_capture import BACKGROUND, draw, known_texture, ring_camera, sphere

from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Document, Split
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.planning.planner import full_model, plan

FRAMES = 8


def written(path: Path, vertices: np.ndarray, pose: np.ndarray, turns: np.ndarray, colours: np.ndarray, *,
            worn: float = 1.0,
            shining: Callable[[Camera, np.ndarray], np.ndarray] | None = None) -> Capture:
    """A capture of a ball, from four cameras.

    Args:
        vertices: (T, V, 3); pose: (T, 2, 3); turns: (T, 3) of the root; colours: (T, 3·F, 3) sRGB of the
            triangles' corners.
        worn: what is drawn is so many times the size of the body.
        shining: (3·F,) added to the colours, by the camera and a frame's vertices.
    """
    body = sphere()
    poses = Poses(np.arange(FRAMES), vertices.astype(np.float32), pose.astype(np.float32),
                  turns.astype(np.float32),
                  np.zeros((FRAMES, 3), np.float32))
    cameras = {f"c{i}": ring_camera(f"c{i}", 1.57 * i, 0.5 * (-1) ** i) for i in range(4)}
    splits = {"train": Split(tuple(cameras), tuple(range(FRAMES)))}
    document = Document(name=path.name, background=BACKGROUND, cameras=cameras, splits=splits)
    writer = CaptureWriter(path, document)
    for camera, frame in document.images():
        added = 0.0 if shining is None else shining(cameras[camera], vertices[frame])[:, None]
        writer.write(camera, frame,
                     *draw(body, worn * vertices[frame], cameras[camera], colours[frame] + added))
    writer.finish(body, poses)
    return Capture.read(path)


@pytest.mark.long
def test_shading_of_a_ball_that_turns_in_a_fixed_light_keeps_the_normal(tmp_path: Path) -> None:
    body = sphere()
    turns = np.array([[0, 2 * np.pi * frame / FRAMES, 0] for frame in range(FRAMES)])
    vertices = np.stack([Rotation.from_rotvec(turn).apply(body.template) for turn in turns])
    light = np.array([0.8, 0.6, 0.0])
    normals = vertices[:, body.faces.ravel()] / np.linalg.norm(vertices[:, body.faces.ravel()], axis=-1,
                                                               keepdims=True)
    shading = 0.4 + 0.6 * np.maximum(normals @ light, 0)[..., None]
    capture = written(tmp_path / "light", vertices, np.zeros((FRAMES, 2, 3)), turns,
                      shading * known_texture(body.uv[body.uv_faces.ravel()]))
    found, full = plan(capture), full_model()
    assert found.preset.normal_octaves == full.normal_octaves
    assert (found.preset.colour_layers, found.preset.feature_width) == (full.colour_layers,
                                                                        full.feature_width)
    assert found.preset.pose_layers == ()
    assert {finding.key for finding in found.findings if not finding.left_out} >= {"light"}


@pytest.mark.long
def test_a_pattern_that_follows_the_pose_keeps_the_pose(tmp_path: Path) -> None:
    body = sphere()
    # The ball is stretched in every other frame, which its normals show; the pattern moves, which they do
    # not.
    vertices = np.stack([body.template * ((1, 1, 1) if frame % 2 else (0.95, 1.1, 0.95))
                         for frame in range(FRAMES)])
    moved = np.linspace(-1, 1, FRAMES)
    uv = body.uv[body.uv_faces.ravel()]
    capture = written(tmp_path / "pose", vertices,
                      np.stack([np.array([[0, 0, 0], [0, 0, m]]) for m in moved]), np.zeros((FRAMES, 3)),
                      np.stack([known_texture(uv + (0.06 * m, 0)) for m in moved]))
    found, full = plan(capture), full_model()
    assert found.preset.pose_layers == full.pose_layers and found.preset.colour_layers == full.colour_layers
    assert found.preset.normal_octaves == -1


def turning() -> tuple[np.ndarray, np.ndarray]:
    """Rotation vectors (T, 3) of a ball that turns once around, and its vertices."""
    turns = np.array([[0, 2 * np.pi * frame / FRAMES, 0] for frame in range(FRAMES)])
    return turns, np.stack([Rotation.from_rotvec(turn).apply(sphere().template) for turn in turns])


@pytest.mark.long
def test_highlights_of_a_ball_that_turns_keep_the_view_mirrored(tmp_path: Path) -> None:
    body = sphere()
    turns, vertices = turning()
    light = np.array([0.48, 0.6, 0.64])

    def shining(camera: Camera, posed: np.ndarray) -> np.ndarray:
        point = posed[body.faces.ravel()]
        normal = point / np.linalg.norm(point, axis=1, keepdims=True)
        away = camera.position - point
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        mirrored = 2 * (away * normal).sum(1, keepdims=True) * normal - away
        return 0.5 * np.maximum(mirrored @ light, 0) ** 4

    colours = np.broadcast_to(0.6 * known_texture(body.uv[body.uv_faces.ravel()]),
                              (FRAMES, body.faces.size, 3))
    still = np.zeros((FRAMES, 2, 3))
    found = plan(written(tmp_path / "shining", vertices, still, turns, colours, shining=shining)).preset
    assert (found.direction_octaves, found.direction) == (full_model().direction_octaves, "mirrored")
    dull = plan(written(tmp_path / "dull", vertices, still, turns, colours)).preset
    assert (dull.direction_octaves, dull.direction) == (-1, "view")


@pytest.mark.long
def test_bands_reach_as_far_as_what_is_worn(tmp_path: Path) -> None:
    """And half a pixel further: at 2.2 m minus the ball's half metre, a pixel spans about 26 mm."""
    body = sphere()
    turns, vertices = turning()
    colours = np.broadcast_to(known_texture(body.uv[body.uv_faces.ravel()]), (FRAMES, body.faces.size, 3))
    bands = [plan(written(tmp_path / str(worn), vertices, np.zeros((FRAMES, 2, 3)), turns, colours,
                          worn=worn)).preset.band
             for worn in (1.0, 1.12)]
    assert 0.013 <= bands[0] < 0.05 and bands[1] >= 0.06 + 0.013
