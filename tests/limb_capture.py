"""A capture of a limb with two joints that bends at its middle."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sphere_capture import BACKGROUND, draw, ring_camera, sphere

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Document, Split
from ndf_mi.capture.writer import CaptureWriter

ANGLES = {0: 0.0, 1: 0.5, 2: 1.0, 5: -0.6, 6: 0.8}
"""Radians by frame; the last two are not in the training split."""


def limb() -> Body:
    """An ellipsoid, 1.2 m long and 0.4 m thick, with joints at its lower end and at its middle."""
    body = sphere(16, 16)
    template = body.template * [0.4, 1.2, 0.4]
    upper = 1 / (1 + np.exp(-template[:, 1] / 0.05))
    return dataclasses.replace(
        body, template=template, joints=np.array([[0, -0.6, 0], [0, 0, 0]]), joint_names=("lower", "upper"),
        parents=np.array([-1, 0]), weights=np.stack([1 - upper, upper], axis=1))


def bent(body: Body, angles: dict[int, float]) -> Poses:
    """The limb with its upper half turned by these angles, each a bit to one side and turned as a whole."""
    count = len(angles)
    pose, root = np.zeros((count, 2, 3), np.float32), np.zeros((count, 3), np.float32)
    pose[:, 1, 2], root[:, 1] = list(angles.values()), 0.3 * np.arange(count)
    shift = 0.05 * np.arange(count, dtype=np.float32)[:, None] * np.array([1, 0, 0], np.float32)
    vertices = [skin(body, *of).numpy().reshape(-1, 3) for of in zip(pose, root, shift, strict=True)]
    return Poses(np.array(list(angles)), np.stack(vertices), pose, root, shift)


@pytest.fixture(scope="session")
def limb_capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    body = limb()
    poses = bent(body, ANGLES)
    cameras = [ring_camera(f"c{i}", 1.57 * i, 0.3) for i in range(4)] + [ring_camera("n0", 0.8)]
    seen, unseen = tuple(ANGLES)[:3], tuple(ANGLES)[3:]
    splits = {"train": Split(("c0", "c1", "c2", "c3"), seen), "novel_view": Split(("n0",), seen),
              "novel_pose": Split(("n0",), unseen)}
    document = Document(name="limb", background=BACKGROUND, cameras={c.name: c for c in cameras},
                        splits=splits)
    writer = CaptureWriter(tmp_path_factory.mktemp("limb") / "limb", document)
    for camera, frame in document.images():
        row = poses.index(frame)
        writer.write(camera, frame, *draw(body, poses.vertices[row], document.cameras[camera]))
    writer.finish(body, poses)
    return Capture.read(writer.path)
