"""Bodies for the tests of `ndf_mi.body`."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ndf_mi.body.anny import load_anny
from ndf_mi.body.body import Body


@pytest.fixture(scope="session")
def anny() -> Body:
    return load_anny()


@pytest.fixture
def small() -> Body:
    """A body of 40 vertices and 4 joints with every optional field, all random; its triangles mean
    nothing.
    """
    rng = np.random.default_rng(7)
    weights = rng.random((40, 4)) * (rng.random((40, 4)) < 0.6) + 1e-3
    return Body(faces=rng.integers(0, 40, (20, 3)), uv=rng.random((30, 2)),
                uv_faces=rng.integers(0, 30, (20, 3)), template=rng.normal(size=(40, 3)),
                joints=rng.normal(size=(4, 3)), joint_names=("pelvis", "chest", "arm", "leg"),
                parents=np.array([-1, 0, 1, 0]), weights=weights / weights.sum(1, keepdims=True),
                shape_dirs=rng.normal(size=(40, 3, 2)) * 0.1, pose_dirs=rng.normal(size=(40, 3, 27)) * 0.1,
                joint_dirs=rng.normal(size=(4, 3, 2)) * 0.1, shape_names=("height", "weight"))


@pytest.fixture
def fields(small: Body) -> dict:
    """The fields of `small`, to be spoilt one at a time."""
    return {f.name: getattr(small, f.name) for f in dataclasses.fields(small)}
