"""A tiny capture: a moving sphere with a known texture, an area emitter that Mitsuba renders."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Document, Split
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.mitsuba_mesh import make_mesh

SIZE = 48
BACKGROUND = (0.2, 0.3, 0.4)
FRAMES = (2, 5, 7)


def sphere(rows: int = 24, columns: int = 32) -> Body:
    """A unit sphere whose texture has a seam along one meridian."""
    turn = 2 * np.pi * np.arange(columns) / columns
    theta, phi = np.meshgrid(np.linspace(0.05, np.pi - 0.05, rows), turn, indexing="ij")
    vertices = np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1
    ).reshape(-1, 3)
    v, u = np.meshgrid(1 - np.arange(rows) / (rows - 1), np.arange(columns + 1) / columns, indexing="ij")
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")

    def triangles(width: int, following: np.ndarray) -> np.ndarray:
        a, b = row * width + column, row * width + following
        quads = np.stack([a, a + width, b + width, a, b + width, b], -1)
        return quads.reshape(-1, 3).astype(np.int32)

    faces = triangles(columns, (column + 1) % columns)
    uv_faces = triangles(columns + 1, column + 1)
    uv = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)
    return Body(faces=faces, uv=uv, uv_faces=uv_faces, template=(0.5 * vertices).astype(np.float32))


def known_texture(uv: np.ndarray) -> np.ndarray:
    """(N, 2) → (N, 3) smooth sRGB colours, equal on both sides of the seam."""
    u, v = 2 * np.pi * uv[:, 0], uv[:, 1]
    return np.stack([0.5 + 0.3 * np.sin(u), 0.2 + 0.6 * v, 0.5 + 0.3 * np.cos(2 * u) * np.sin(np.pi * v)], -1)


def ring_camera(name: str, angle: float, height: float = 0.4, size: int = SIZE) -> Camera:
    position = np.array([2.2 * np.sin(angle), height, 2.2 * np.cos(angle)])
    back = position / np.linalg.norm(position)
    right = np.cross([0, 1, 0], back) / np.linalg.norm(np.cross([0, 1, 0], back))
    transform = np.eye(4)
    transform[:3] = np.stack([right, np.cross(back, right), back, position], axis=1)
    return Camera(name, size, size, 1.5 * size, 1.5 * size, 0.51 * size, 0.48 * size, transform)


def draw(
    body: Body, vertices: np.ndarray, camera: Camera, colours: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Renders the truth from vertex colours: it shares only Mitsuba with what is tested.

    Args:
        colours: (3·F, 3) sRGB of the triangles' corners, instead of the known texture.
    """
    corners, uv = body.faces.ravel(), body.uv[body.uv_faces.ravel()]
    colours = known_texture(uv) if colours is None else colours
    properties = mi.Properties()
    radiance = {"type": "mesh_attribute", "name": "vertex_colour"}
    properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    mesh = make_mesh(
        "truth",
        vertices[corners],
        np.arange(len(corners)).reshape(-1, 3),
        attributes={"vertex_colour": srgb_to_linear(colours)},
        props=properties,
    )
    scene = mi.load_dict({"type": "scene", "mesh": mesh, "integrator": {"type": "path", "max_depth": 1}})
    sensor = mi.load_dict(camera.sensor(spp=64, sampler="multijitter"))
    rgba = mi.render(scene, sensor=sensor, spp=64).numpy()
    alpha = np.clip(rgba[..., 3:], 0, 1)
    image = linear_to_srgb(rgba[..., :3] + (1 - alpha) * srgb_to_linear(np.array(BACKGROUND)))
    return np.clip(image, 0, 1).astype(np.float32), alpha[..., 0] > 0.5


@pytest.fixture(scope="session")
def write_capture(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Writes the capture under a name, which changes its digest."""

    def write(name: str) -> Path:
        body = sphere()
        shifts = np.array([[0, 0, 0], [0.1, 0, 0.05], [-0.1, 0.1, 0]], dtype=np.float32)
        vertices = body.template[None] + shifts[:, None]
        zeros = np.zeros((3, 3), dtype=np.float32)
        poses = Poses(np.array(FRAMES), vertices, np.zeros((3, 1, 3), np.float32), zeros, shifts)
        cameras = [ring_camera(f"c{i}", 1.57 * i, 0.5 * (-1) ** i) for i in range(4)]
        cameras += [ring_camera("n0", 0.8), ring_camera("n1", 3.9)]
        train, held = ("c0", "c1", "c2", "c3"), ("n0", "n1")
        splits = {
            "train": Split(train, FRAMES[:2]),
            "novel_view": Split(held, FRAMES[:2]),
            "novel_pose": Split(held, FRAMES[2:]),
        }
        document = Document(
            name=name, background=BACKGROUND, cameras={c.name: c for c in cameras}, splits=splits
        )
        writer = CaptureWriter(tmp_path_factory.mktemp("capture") / name, document)
        for camera, frame in document.images():
            index = FRAMES.index(frame)
            writer.write(camera, frame, *draw(body, vertices[index], document.cameras[camera]))
        writer.finish(body, poses)
        return writer.path

    return write


@pytest.fixture(scope="session")
def capture(write_capture: Callable[[str], Path]) -> Capture:
    return Capture.read(write_capture("sphere"))


def with_body(capture: Capture, body: Body, poses: Poses) -> Capture:
    """The capture with another body in its place; the images stay."""
    changed = copy.copy(capture)
    changed.body, changed.poses = body, poses
    return changed


@pytest.fixture(scope="session")
def shrunk_capture(capture: Capture) -> Capture:
    """The capture with a body of 0.45 m instead of the 0.5 m that its images show."""
    body = dataclasses.replace(capture.body, template=0.9 * capture.body.template)
    vertices = capture.poses.vertices - 0.1 * capture.body.template
    return with_body(capture, body, dataclasses.replace(capture.poses, vertices=vertices))
