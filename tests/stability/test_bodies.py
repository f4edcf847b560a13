"""Posed bodies: rotations by any angle, and skinning with its derivatives."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.skinning import rodrigues, skin
from ndf_mi.stability.case import Check, case, decades, error

ANGLES = (
    0.0, *decades(-38, -1, 3), 1e-8, 0.0999, 0.1001, 1.0, np.pi / 2, np.pi - 1e-6, np.pi, np.pi + 1e-6,
    2 * np.pi - 1e-6, 2 * np.pi, 2 * np.pi + 1e-6)
AXES = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, -0.48, 0.64], [-1 / 3, 2 / 3, 2 / 3]])


def cross(v: np.ndarray) -> np.ndarray:
    """The matrix of the cross product with v (3,)."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rotation(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation matrix of an axis-angle vector by the matrix exponential, and its (3, 3, 3) derivatives in
    each component.

    These are the upper right block of exp([[K, E], [0, K]]) (Najfeld and Havel 1995).
    """
    derivatives = []
    for axis in range(3):
        block = np.zeros((6, 6))
        block[:3, :3] = block[3:, 3:] = cross(v)
        block[:3, 3:] = cross(np.eye(3)[axis])
        derivatives.append(expm(block)[:3, 3:])
    return expm(cross(v)), np.array(derivatives)


@case(
    "rotations by axis and angle", "0, 1e-38 to 0.1, 1, π/2, π, 2π, and 1e-6 about these two",
    relative_to="1, the columns' length")
@pytest.mark.parametrize("angle", ANGLES, ids="{:.8g}".format)
def test_rotations(check: Check, angle: float) -> None:
    """The nine entries and their 27 derivatives, about five axes."""
    vectors = (angle * AXES).astype(np.float32)
    truth = [rotation(v.astype(np.float64)) for v in vectors]
    primal, gradient = 0.0, 0.0
    for row in range(3):
        for column in range(3):
            v = mi.Vector3f(np.ascontiguousarray(vectors.T))
            dr.enable_grad(v)
            entry = rodrigues(v)[row, column]
            dr.backward(dr.sum(entry))
            primal = max(primal, error(entry.numpy(), [matrix[row, column] for matrix, _ in truth], 1.0))
            gradient = max(
                gradient, error(dr.grad(v).numpy().T, [slopes[:, row, column] for _, slopes in truth], 1.0))
    check(primal, gradient)


def chain(size: float, rng: np.random.Generator) -> Body:
    """A body of 60 vertices around a chain of eight joints, with blend shapes for shape and pose."""
    joints = np.cumsum(rng.normal(0, 0.15, (8, 3)), 0)
    weights = rng.random((60, 8)) ** 6 + 1e-6
    near = joints[weights.argmax(1)] + rng.normal(0, 0.1, (60, 3))
    return Body(
        faces=rng.integers(0, 60, (30, 3)), uv=rng.random((60, 2)), uv_faces=rng.integers(0, 60, (30, 3)),
        template=size * near, joints=size * joints, joint_names=tuple(f"j{j}" for j in range(8)),
        parents=np.arange(-1, 7), weights=weights / weights.sum(1, keepdims=True),
        shape_dirs=size * rng.normal(0, 0.05, (60, 3, 2)), pose_dirs=size * rng.normal(0, 0.05, (60, 3, 63)),
        joint_dirs=size * rng.normal(0, 0.02, (8, 3, 2)), shape_names=("a", "b"))


def skinned64(
    body: Body, pose: np.ndarray, root: np.ndarray, translation: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(V, 3) posed vertices in float64, joint by joint down the chain."""
    fields = (body.template, body.joints, body.weights, body.shape_dirs, body.pose_dirs, body.joint_dirs)
    template, joints, weights, shape_dirs, pose_dirs, joint_dirs = (np.asarray(f, np.float64) for f in fields)
    at = joints + joint_dirs @ shape
    *rotations, whole = Rotation.from_rotvec(np.concatenate([pose, root[None]])).as_matrix()
    rest = (
        template + shape_dirs @ shape
        + pose_dirs @ np.concatenate([(r - np.eye(3)).ravel() for r in rotations[1:]]))
    total = np.zeros_like(template)
    transform = np.eye(4)
    for j, turn in enumerate(rotations):
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turn, at[j] - (at[j - 1] if j else 0)
        transform = transform @ local
        total += weights[:, j : j + 1] * ((rest - at[j]) @ transform[:3, :3].T + transform[:3, 3])
    return total @ whole.T + translation


def derivative(function: Callable[[np.ndarray], float], at: np.ndarray, step: float) -> np.ndarray:
    """The gradient of a smooth function by central differences, extrapolated once (Richardson)."""
    found = np.zeros(at.shape)
    for index in np.ndindex(at.shape):
        way = np.zeros(at.shape)
        way[index] = 1
        coarse, fine = (
            (function(at + width * way) - function(at - width * way)) / (2 * width)
            for width in (step, step / 2))
        found[index] = (4 * fine - coarse) / 3
    return found


@case(
    "skinned bodies, all joints at one angle, and derivatives in pose, place and shape",
    "angles as above; bodies of 1 mm to 1 km, up to 1e6 m away",
    relative_to="the body's size and, for places, that of its coordinates; derivatives to the largest")
@pytest.mark.parametrize(
    ("angle", "size", "away"),
    [
        *((angle, 1.0, 0.0) for angle in ANGLES),
        *((0.7, 10.0**k, away) for k in (-3, 0, 3) for away in (0.0, 1e3, 1e6))],
    ids="{:.8g}".format,
)
def test_skinned_bodies(check: Check, angle: float, size: float, away: float) -> None:
    """Eight joints in a chain, each turned about another axis."""
    rng = np.random.default_rng(5)
    body = chain(size, rng)
    axes = rng.normal(size=(8, 3))
    pose = angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    pose[0] = 0
    values = [pose, angle * AXES[3], away * np.array([0.6, -0.8, 0.0]), np.array([0.5, -1.0])]
    values = [value.astype(np.float32) for value in values]
    exact = [value.astype(np.float64) for value in values]
    factors = rng.normal(size=(60, 3)).astype(np.float32)
    arguments = [mi.Float(np.ascontiguousarray(value.ravel())) for value in values]
    dr.enable_grad(arguments)
    vertices = skin(body, *arguments)
    dr.backward(dr.sum(vertices * mi.Float(factors.ravel())))
    # The translation is only added. Far away it would take the digits that differences need.
    near = [*exact[:2], 0 * exact[2], exact[3]]
    gradient = 0.0
    for index, argument in enumerate(arguments):

        def weighted_sum(value: np.ndarray, index: int = index) -> float:
            return float(
                (
                    skinned64(body, *(value if k == index else other for k, other in enumerate(near)))
                    * factors).sum()
            )

        slope = derivative(weighted_sum, near[index], 2e-3 * (size if index == 2 else 1))
        gradient = max(
            gradient, error(dr.grad(argument).numpy().reshape(slope.shape), slope, np.abs(slope).max()))
    check(error(vertices.numpy().reshape(-1, 3), skinned64(body, *exact), size + away), gradient)
