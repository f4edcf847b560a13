"""A run around a ball that is a body with a model: two joints, two shape coefficients."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from conftest import ball

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.field import preset
from ndf_mi.run import Run


@pytest.fixture
def model_run(tmp_path: Path) -> Run:
    """The lower half of the ball follows the root, the upper half a joint in its middle; ``wide`` doubles x,
    ``tall`` doubles y."""
    body, poses = ball()
    assert body.template is not None
    upper = (body.template[:, 1] > 0).astype(np.float32)
    body = Body(
        body.faces, body.uv, body.uv_faces, body.template,
        joints=np.array([[0, -0.3, 0], [0, 0, 0]], np.float32),
        joint_names=("bottom", "middle"), parents=np.array([-1, 0]), weights=np.stack([1 - upper, upper], 1),
        shape_dirs=body.template[..., None] * np.eye(3, dtype=np.float32)[:, :2],
        shape_names=("wide", "tall"),
    )  # fmt: skip
    poses = dataclasses.replace(poses, shape=np.zeros(2, np.float32))
    assert isinstance(poses, Poses)
    run = Run.create(tmp_path / "model", preset("tiny"), body, poses, seed=1, background=[0.2, 0.3, 0.4])
    run.save()
    return run
