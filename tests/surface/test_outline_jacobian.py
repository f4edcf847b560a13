"""The derivatives of outlines against differences of skinned vertices and of projections."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sphere_capture import ring_camera

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.learn.camera_corrections import corrected
from ndf_mi.surface.contours import projection_vjp
from ndf_mi.surface.outline_fit import Moves
from ndf_mi.surface.outline_jacobian import PoseJacobian, camera_rows, left_jacobian, vertex_rows

RNG = np.random.default_rng(3)
STEP = 2e-3


@pytest.fixture(scope="module")
def body():
    """A body of 40 vertices and 4 joints in a branching tree, all random; its triangles mean nothing."""
    weights = RNG.random((40, 4)) * (RNG.random((40, 4)) < 0.6) + 1e-3
    return Body(faces=RNG.integers(0, 40, (20, 3)), uv=RNG.random((30, 2)),
                uv_faces=RNG.integers(0, 30, (20, 3)), template=RNG.normal(size=(40, 3)),
                joints=RNG.normal(size=(4, 3)), joint_names=("pelvis", "chest", "arm", "leg"),
                parents=np.array([-1, 0, 1, 0]), weights=weights / weights.sum(1, keepdims=True),
                shape_dirs=RNG.normal(size=(40, 3, 2)) * 0.1, joint_dirs=RNG.normal(size=(4, 3, 2)) * 0.1,
                shape_names=("height", "weight"))


def moves_of(vertices, direction):
    """20 points between random vertices."""
    start, end = RNG.integers(0, len(vertices), (2, 20))
    position = RNG.random(20)
    point = vertices[start] + position[:, None] * (vertices[end] - vertices[start])
    return Moves(start, end, position, point, direction, np.zeros(20), np.ones(20, bool), np.ones(20))


def directions():
    vectors = RNG.normal(size=(20, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_joints_root_and_shift(body):
    pose = RNG.normal(size=(1, 4, 3)) * 0.7
    pose[0, 0] = 0
    offsets, turn, shape = 0.1 * RNG.normal(size=(40, 3)), RNG.normal(size=3) * 0.5, RNG.normal(size=2)
    given = Poses(np.array([5]), np.zeros((1, 40, 3)), pose, RNG.normal(size=(1, 3)), RNG.normal(size=(1, 3)),
                  shape)
    clothed = dataclasses.replace(body, template=body.template + offsets)
    joint = body.joints[0] + body.joint_dirs[0] @ shape
    pivot = Rotation.from_rotvec(given.root_rotation[0]).apply(joint) + given.translation[0]

    def at(row):
        """The fit with the correction, as pose corrections define it."""
        turned = Rotation.from_rotvec(turn + row[:3])
        angles = given.pose[0] + row[:12].reshape(4, 3)
        angles[0] = 0
        root = (turned * Rotation.from_rotvec(given.root_rotation[0])).as_rotvec()
        return angles, root, turned.apply(given.translation[0] - pivot) + pivot + row[12:], shape

    def vertices(row):
        return np.asarray(skin(clothed, *at(row))).reshape(-1, 3).astype(np.float64)

    here = at(np.zeros(15))
    poses = dataclasses.replace(given, pose=here[0][None], root_rotation=here[1][None],
                                translation=here[2][None])
    moves = moves_of(vertices(np.zeros(15)), directions())
    found = PoseJacobian(body, poses, 0, offsets, turn).rows(moves)
    steps = STEP * np.eye(15)
    motion = np.stack([(vertices(step) - vertices(-step)) / (2 * STEP) for step in steps], -1)
    np.testing.assert_allclose(found, vertex_rows(moves, motion), atol=2e-3)
    assert np.abs(found).max() > 0.5


def test_cameras():
    camera = ring_camera("a", 0.4)
    points, normals = 0.4 * RNG.normal(size=(20, 3)), RNG.normal(size=(20, 2))
    along = projection_vjp(camera, points, normals)
    scale = np.linalg.norm(along, axis=1)
    moves = moves_of(points, along / scale[:, None])
    moves = dataclasses.replace(moves, point=points)

    def seen(row):
        moved = corrected(camera, row[:3], row[3:6], row[6])
        return (normals * moved.project(points)).sum(1) / scale

    expected = np.stack([(seen(1e-4 * unit) - seen(-1e-4 * unit)) / 2e-4 for unit in np.eye(7)], -1)
    np.testing.assert_allclose(camera_rows(camera, moves), expected, atol=1e-4)


@pytest.mark.parametrize("angle", [np.zeros(3), np.array([1e-5, 0, 0]), np.array([0.5, -1.2, 0.8])])
def test_the_left_jacobian(angle):
    turn = Rotation.from_rotvec(angle)
    expected = [((Rotation.from_rotvec(angle + 1e-5 * unit) * turn.inv()).as_rotvec()
                 - (Rotation.from_rotvec(angle - 1e-5 * unit) * turn.inv()).as_rotvec()) / 2e-5
                for unit in np.eye(3)]
    np.testing.assert_allclose(left_jacobian(angle), np.stack(expected, -1), atol=1e-6)
