"""Skinning in Dr.Jit against a dense float64 numpy evaluation, its gradients against central differences of
that.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ndf_mi.body import Body
from ndf_mi.body.anny import load_anny_garments
from ndf_mi.body.skinning import SkinnedVertices, joint_transforms, rodrigues, skin
from ndf_mi.errors import InputError


def dense(body: Body, pose, root, shift, beta=None) -> np.ndarray:
    """The same vertices by 4×4 matrices down the kinematic tree, (V, 3) float64."""
    pose = np.asarray(pose, dtype=np.float64)
    rest, joints = body.template.astype(np.float64), body.joints.astype(np.float64)
    if beta is not None:
        rest = rest + body.shape_dirs.astype(np.float64) @ beta
        joints = joints + body.joint_dirs.astype(np.float64) @ beta
    local = Rotation.from_rotvec(pose).as_matrix()
    if body.pose_dirs is not None:
        rest = rest + body.pose_dirs.astype(np.float64) @ (local[1:] - np.eye(3)).ravel()
    world = []
    for j, p in enumerate(body.parents):
        matrix = np.eye(4)
        matrix[:3, :3] = local[j]
        matrix[:3, 3] = joints[j] - (joints[p] if p >= 0 else 0)
        world.append(matrix if p < 0 else world[p] @ matrix)
    moved = []
    for matrix, joint in zip(world, joints, strict=True):
        undo = np.eye(4)
        undo[:3, 3] = -joint
        moved.append(matrix @ undo)
    blended = np.tensordot(body.weights.astype(np.float64), np.array(moved), axes=1)
    x = np.einsum("vab,vb->va", blended[:, :3], np.c_[rest, np.ones(len(rest))])
    return x @ Rotation.from_rotvec(root).as_matrix().T + shift


def random_pose(body: Body, seed: int, scale: float = 0.6) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(body.joint_count, 3)) * scale
    return pose, rng.normal(size=3), rng.normal(size=3), rng.normal(size=body.shape_count)


def vertices(flat: mi.Float) -> np.ndarray:
    return np.array(flat, dtype=np.float64).reshape(-1, 3)


@pytest.mark.parametrize("seed", [0, 1])
def test_anny(anny: Body, seed: int) -> None:
    arguments = random_pose(anny, seed)
    np.testing.assert_allclose(vertices(skin(anny, *arguments)), dense(anny, *arguments), atol=3e-6)


def test_every_field(small: Body) -> None:
    """With pose blend shapes, two branches and a shape; and without the shape."""
    arguments = random_pose(small, 3)
    np.testing.assert_allclose(vertices(skin(small, *arguments)), dense(small, *arguments), atol=3e-6)
    np.testing.assert_allclose(vertices(skin(small, *arguments[:3])), dense(small, *arguments[:3]), atol=3e-6)


def test_rest_pose(anny: Body) -> None:
    zero = np.zeros(3)
    np.testing.assert_allclose(vertices(skin(anny, np.zeros((31, 3)), zero, zero)), anny.template, atol=1e-6)


def test_root_turns_about_the_origin(anny: Body) -> None:
    """A quarter turn about z takes (x, y, z) to (-y, x, z), wherever the root joint is; the translation comes
    after.
    """
    posed = vertices(skin(anny, np.zeros((31, 3)), [0, 0, np.pi / 2], [1, 2, 3]))
    x, y, z = anny.template.T
    np.testing.assert_allclose(posed, np.stack([1 - y, 2 + x, 3 + z], 1), atol=1e-6)


def test_rigid_chain() -> None:
    """An arm of two bones along x: the elbow at 90° about z lifts the hand."""
    body = Body(
        faces=[[0, 1, 2]], uv=[[0, 0], [1, 0], [0, 1]], uv_faces=[[0, 1, 2]],
        template=[[0.5, 0, 0], [1, 0, 0], [2, 0, 0]], joints=[[0, 0, 0], [1, 0, 0]],
        joint_names=("upper", "fore"),
        parents=[-1, 0], weights=[[1, 0], [0.5, 0.5], [0, 1]],
    )  # fmt: skip
    posed = vertices(skin(body, [[0, 0, 0], [0, 0, np.pi / 2]], [0, 0, 0], [0, 0, 0]))
    np.testing.assert_allclose(posed, [[0.5, 0, 0], [1, 0, 0], [1, 1, 0]], atol=1e-6)


@pytest.mark.parametrize("kind", ["tensor", "float", "list"])
def test_argument_types(small: Body, kind: str) -> None:
    make = {"tensor": mi.TensorXf, "float": lambda a: mi.Float(np.ravel(a)), "list": np.ndarray.tolist}[kind]
    arguments = random_pose(small, 5)
    posed = skin(small, *(make(a.astype(np.float32)) for a in arguments))
    np.testing.assert_allclose(vertices(posed), dense(small, *arguments), atol=3e-6)


def test_garments_share_the_joints(anny: Body) -> None:
    """A garment cut from the body's own vertices lands where the body does."""
    arguments = random_pose(anny, 4, 0.3)
    transforms = joint_transforms(anny, *arguments)
    chosen = slice(100, 5000, 7)
    cut = SkinnedVertices(anny.template[chosen], anny.weights[chosen], anny.shape_dirs[chosen])
    np.testing.assert_allclose(vertices(cut.apply(transforms)), dense(anny, *arguments)[chosen], atol=3e-6)
    skirt = load_anny_garments()["helper-skirt"]
    posed = vertices(SkinnedVertices(skirt.template, skirt.weights, skirt.shape_dirs).apply(transforms))
    assert np.isfinite(posed).all() and posed.shape == skirt.template.shape


@pytest.mark.parametrize("scale", [0.0, 1e-6, 1e-3, 0.1, 0.7])
@pytest.mark.parametrize("which", [0, 1, 2, 3])
def test_gradient(small: Body, which: int, scale: float) -> None:
    """d⟨w, V⟩ along a random direction of pose, root rotation, translation or shape."""
    rng = np.random.default_rng(which)
    arguments = [a * scale for a in random_pose(small, 11, 1.0)]
    weights, direction = rng.normal(size=(40, 3)), rng.normal(size=np.shape(arguments[which]))

    variables = [mi.TensorXf(a.astype(np.float32)) for a in arguments]
    dr.enable_grad(variables[which])
    dr.backward(dr.sum(skin(small, *variables) * mi.Float(weights.ravel().astype(np.float32))))
    gradient = np.array(variables[which].grad, dtype=np.float64)

    def value(step: float) -> float:
        moved = list(arguments)
        moved[which] = moved[which] + step * direction
        return float((dense(small, *moved) * weights).sum())

    expected = (value(1e-5) - value(-1e-5)) / 2e-5
    assert np.sum(gradient * direction) == pytest.approx(expected, rel=2e-4, abs=2e-3)


def test_gradient_of_zero_literals(small: Body) -> None:
    """dr.zeros makes literals; the gradient must be there and finite all the same."""
    pose = dr.zeros(mi.TensorXf, (4, 3))
    dr.enable_grad(pose)
    dr.backward(dr.sum(dr.square(skin(small, pose, [0, 0, 0], [0, 0, 0]))))
    gradient = np.array(pose.grad)
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0.1


@pytest.mark.parametrize("angle", [0, 1e-12, 1e-5, 0.05, 0.0999, 0.1001, 1.0, np.pi, 6.0, 20.0])
def test_rodrigues(angle: float) -> None:
    axis = np.array([0.36, -0.48, 0.8])
    matrix = np.array(rodrigues(mi.Vector3f(*(mi.Float(float(v)) for v in axis * angle))))[..., 0]
    np.testing.assert_allclose(matrix, Rotation.from_rotvec(axis * angle).as_matrix(), atol=3e-6)


def test_no_kernel_for_a_new_pose(anny: Body) -> None:
    """Poses, zeros among them, replay the kernels of the first."""

    def compiled(*arguments: np.ndarray) -> int:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(skin(anny, *arguments))
            return sum(not k["cache_hit"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT)

    compiled(*random_pose(anny, 0))
    assert compiled(*random_pose(anny, 1)) == 0
    assert compiled(*(np.zeros_like(a) for a in random_pose(anny, 2))) == 0


def test_refuses(small: Body) -> None:
    good = random_pose(small, 0)
    for which, (name, expected) in enumerate((("pose", 12), ("root_rotation", 3), ("translation", 3),
                                              ("shape", 2))):
        bad = list(good)
        bad[which] = np.zeros(5)
        with pytest.raises(InputError, match=f"{name}: found 5 values; expected {expected}"):
            skin(small, *bad)
    with pytest.raises(InputError, match="no template, joints"):
        skin(Body(small.faces, small.uv, small.uv_faces), *good)
