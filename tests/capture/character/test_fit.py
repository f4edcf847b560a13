"""Fitting Anny to characters: derivatives, and bodies that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ndf_mi import variants
from ndf_mi.body.anny import MEASURES, SHAPE_NAMES, load_anny
from ndf_mi.body.body import Body
from ndf_mi.body.mesh import vertex_normals
from ndf_mi.body.motion import shaped_joints
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import joint_transforms, skin
from ndf_mi.capture.synthesise.character import fit as fitting
from ndf_mi.capture.synthesise.character.fit import Target, fit
from ndf_mi.capture.synthesise.character.joints import REQUIRED
from ndf_mi.capture.synthesise.character.rig import Rig
from ndf_mi.capture.synthesise.character.skin import Mesh, Skin

variants.use()


@pytest.fixture(scope="module")
def body() -> Body:
    return load_anny(measures=True)


def test_measures_follow_the_six_coefficients(body: Body) -> None:
    plain = load_anny()
    assert body.shape_names == SHAPE_NAMES + tuple(MEASURES) and plain.shape_names == SHAPE_NAMES
    np.testing.assert_array_equal(body.shape_dirs[..., :6], plain.shape_dirs)
    # A measure changes what it names: the distance from hip to knee.
    at = {sign: shaped_joints(body, sign * np.eye(len(body.shape_names))[6]) for sign in (-1, 1)}
    hip, knee, ankle = (body.joint_names.index(f"Left{name}") for name in ("UpLeg", "Leg", "Foot"))
    thigh, shin = ({sign: np.linalg.norm(j[a] - j[b]) for sign, j in at.items()}
                   for a, b in ((hip, knee), (knee, ankle)))
    assert thigh[1] - thigh[-1] > 0.03 and abs(shin[1] - shin[-1]) < 0.005


def test_points_and_derivatives_equal_those_of_the_skinned_body(body: Body) -> None:
    random = np.random.default_rng(0)
    vertices = random.choice(len(body.template), 15, replace=False)
    rig = Rig(body, vertices)
    joints, shapes = len(body.joints), body.shape_count
    start = Rotation.from_rotvec(random.normal(size=(joints, 3)) * 0.3).as_matrix()
    turns, translation = random.normal(size=(joints, 3)) * 0.2, random.normal(size=3)
    shape, size = random.normal(size=shapes) * 0.5, 0.1
    posed = rig.pose(start, turns, translation, shape, size)

    pose = Rotation.from_matrix(start @ Rotation.from_rotvec(turns).as_matrix()).as_rotvec()
    root, factor = pose[0].copy(), np.float32(np.exp(size))
    pose[0] = 0
    sized = replace(body, **{name: factor * getattr(body, name)
                             for name in ("template", "joints", "shape_dirs", "joint_dirs")})
    row = (array.astype(np.float32) for array in (pose, root, translation, shape))
    expected = np.asarray(skin(sized, *row)).reshape(-1, 3)[vertices]
    np.testing.assert_allclose(posed.points[: len(vertices)], expected, atol=2e-6)

    def at(values: np.ndarray) -> np.ndarray:
        moved = values[: turns.size].reshape(turns.shape)
        return rig.pose(start, moved, translation, values[turns.size : -1], values[-1]).points

    values, step = np.concatenate([turns.ravel(), shape, [size]]), 1e-6
    slopes = np.concatenate([posed.by_turn, posed.by_shape], axis=2)
    for i in range(0, len(values), 5):
        change = step * np.eye(len(values))[i]
        difference = (at(values + change) - at(values - change)) / (2 * step)
        np.testing.assert_allclose(slopes[:, :, i], difference, atol=1e-7)


def test_a_body_that_anny_can_reach_is_found(body: Body) -> None:
    """A character that is Anny, taller and in other poses, whose nodes have axes of their own."""
    random = np.random.default_rng(1)
    shape = np.zeros(body.shape_count, np.float32)
    shape[:2], shape[6:8] = (0.8, -0.4), (0.7, -0.5)
    poses = random.normal(size=(2, len(body.joints), 3)) * 0.15
    poses[:, 0] = 0
    roots, moves = random.normal(size=(2, 3)) * 0.2, np.array([[0, 0.02, 0], [0.3, 0, 0.1]])
    axes = Rotation.from_rotvec(random.normal(size=(len(body.joints), 3))).as_matrix()
    rest = shaped_joints(body, shape)
    bind = np.tile(np.eye(4), (len(rest), 1, 1))
    bind[:, :3, :3], bind[:, :3, 3] = axes, rest
    world, vertices = np.tile(bind, (2, 1, 1, 1)), []
    for t in range(2):
        row = [array[t].astype(np.float32) for array in (poses, roots, moves)]
        transforms = np.asarray(joint_transforms(body, *row, shape).matrices, float).reshape(-1, 3, 4)
        world[t, :, :3] = np.concatenate([transforms, np.tile([[[0, 0, 0, 1.0]]], (len(rest), 1, 1))],
                                         axis=1)[:, :3] @ bind
        vertices.append(np.asarray(skin(body, *row, shape)).reshape(-1, 3))
    names = [*REQUIRED, "Hips", "Neck", "LowerBack", "Spine", "Spine1", "LeftHandFinger1", "RightHandFinger1"]
    joints = {name: body.joint_names.index(name) for name in names}
    mesh = Mesh(np.stack(vertices).astype(float), body.faces, np.arange(len(body.template)))
    sized, found = fit(body, Target(joints, bind, world, Skin(mesh, 4000, 0)))
    found.check(sized)
    away = np.linalg.norm(found.vertices - np.stack(vertices), axis=2)
    # The priors of shape and turns leave some millimetres.
    assert np.median(away) < 0.012 and np.percentile(away, 95) < 0.025, np.percentile(away, [50, 95])
    errors = [np.linalg.norm(world[t, list(joints.values()), :3, 3]
                             - _joints(sized, found, t)[list(joints.values())], axis=1) for t in range(2)]
    assert np.mean(errors) < 0.01, np.mean(errors)


def _joints(body: Body, poses: Poses, row: int) -> np.ndarray:
    transforms = joint_transforms(body, poses.pose[row], poses.root_rotation[row], poses.translation[row],
                                  poses.shape)
    matrices = np.asarray(transforms.matrices, float).reshape(-1, 3, 4)
    return np.einsum("jik,jk->ji", matrices[..., :3], shaped_joints(body, poses.shape)) + matrices[..., 3]


def test_hidden_surfaces_and_loose_cloth_do_not_pull(body: Body) -> None:
    vertices = body.template.astype(float)
    normals = vertex_normals(vertices, body.faces)
    inner = vertices - 0.012 * normals
    both = Mesh(np.concatenate([vertices, inner])[None],
                np.concatenate([body.faces, body.faces + len(vertices)]), np.arange(2 * len(vertices)))
    outer = Skin(both, 3000, 0)
    nearest = cKDTree(vertices).query(outer.points[0])[1]
    away = np.sum((outer.points[0] - vertices[nearest]) * normals[nearest], axis=1)
    # Fingers are thinner than twice the distance of the inner surface.
    assert len(outer.points[0]) > 1000 and np.mean(np.abs(away) < 0.006) > 0.9
    height, _, near = outer.heights(0, vertices, normals, 0.05)
    # The mouth and the like are hidden too.
    assert near.mean() > 0.7 and np.percentile(np.abs(height[near]), 90) < 0.01
    surface = fitting._Surface(body, np.arange(0, len(vertices), 50), outer, 0.012)
    deep = vertices[::50] - 0.03 * normals[::50]
    still = np.tile(np.eye(3), (len(body.joints), 1, 1))
    assert np.median(height[near]) < 0.002
    weights = [np.median(surface.rows(0, points, still)[3]) for points in (vertices[::50], deep)]
    assert weights[1] < 0.1 * weights[0]
