"""Blend weights and skinning against numpy in double precision, and against the body's own skinning."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.body.anny import load_anny
from ndf_mi.body.body import Body
from ndf_mi.body.skinning import joint_transforms, skin
from ndf_mi.methods.animatable_nerf.skinning import Blended, BodyWeights, every, neural_weights, smooth_l1
from ndf_mi.projection import Surface


@pytest.fixture(scope="module")
def anny() -> Body:
    return load_anny()


@pytest.fixture(scope="module", params=[0, 1])
def transforms(anny: Body, request: pytest.FixtureRequest) -> mi.Float:
    return joint_transforms(anny, *random_pose(anny, request.param)).matrices


def random_pose(body: Body, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    pose = 0.4 * rng.normal(size=(body.joint_count, 3))
    pose[0] = 0
    return pose, rng.normal(size=3), rng.normal(size=3)


def tensor(values: np.ndarray) -> mi.TensorXf:
    """(N, J) as the package has it, (J, N)."""
    return mi.TensorXf(np.ascontiguousarray(values.T, np.float32))


def points(values: mi.Point3f) -> np.ndarray:
    return values.numpy().T.astype(np.float64)


def test_body_weights_are_linear_over_triangles(anny: Body) -> None:
    rng = np.random.default_rng(0)
    triangle = rng.integers(0, len(anny.faces), 500).astype(np.uint32)
    barycentric = rng.dirichlet([1, 1, 1], 500).astype(np.float32)
    weights = BodyWeights(anny.weights, Surface(anny.faces, anny.uv, anny.uv_faces, anny.template))
    active = np.arange(500) % 5 > 0
    found = weights.at(mi.UInt32(triangle), mi.Point3f(np.ascontiguousarray(barycentric.T)), mi.Bool(active))
    expected = np.einsum("nkj,nk->nj", anny.weights[anny.faces[triangle]].astype(np.float64), barycentric)
    expected[~active] = 0
    np.testing.assert_allclose(found.numpy().T, expected, atol=1e-6)


def test_the_body_s_own_weights_give_its_own_skinning(anny: Body, transforms: mi.Float,
                                                      request: pytest.FixtureRequest) -> None:
    blended = Blended(transforms, tensor(anny.weights))
    posed = points(blended.forward(mi.Point3f(np.ascontiguousarray(anny.template.T))))
    seed = request.node.callspec.params["transforms"]
    expected = skin(anny, *random_pose(anny, seed)).numpy().reshape(-1, 3)
    np.testing.assert_allclose(posed, expected, atol=5e-6)


def test_forward_and_inverse_return_to_the_same_point(anny: Body, transforms: mi.Float) -> None:
    rng = np.random.default_rng(5)
    around = anny.template + rng.uniform(-0.05, 0.05, anny.template.shape)
    # Softened weights, as a network would give them.
    logits = np.log(anny.weights + 1e-9) + 0.5 * rng.normal(size=anny.weights.shape)
    weights = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    blended = Blended(transforms, tensor(weights))
    world = blended.forward(mi.Point3f(np.ascontiguousarray(around.T, np.float32)))
    back, exists = blended.inverse(world)
    assert exists.numpy().mean() > 0.99
    error = np.linalg.norm(points(back) - around, axis=1)[exists.numpy()]
    assert error.max() < 1e-4


def test_where_joints_crush_the_space_between_them_there_is_no_place() -> None:
    half_turn = np.diag([-1.0, 1.0, -1.0])
    matrices = np.stack([np.c_[np.eye(3), np.zeros(3)], np.c_[half_turn, np.zeros(3)]])
    blended = Blended(mi.Float(matrices.ravel().astype(np.float32)), tensor(np.array([[0.5, 0.5], [1, 0]])))
    place, exists = blended.inverse(mi.Point3f([1.0, 1.0], [2.0, 2.0], [3.0, 3.0]))
    assert exists.numpy().tolist() == [False, True]
    assert np.isfinite(points(place)).all()
    np.testing.assert_allclose(points(place)[1], [1, 2, 3], atol=1e-6)


@pytest.mark.parametrize("scale", [0.0, 1.0, 300.0])
def test_neural_weights_agree_with_float64(scale: float) -> None:
    rng = np.random.default_rng(1)
    body = rng.dirichlet([0.1] * 6, 200).astype(np.float32)
    delta = (scale * rng.normal(size=body.shape)).astype(np.float32)
    found = neural_weights(tensor(body), tensor(delta)).numpy().T
    logits = np.log(body.astype(np.float64) + 1e-9) + np.clip(delta, -40, 40)
    expected = np.exp(logits - logits.max(axis=1, keepdims=True))
    expected /= expected.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(found, expected, atol=2e-5 if scale > 1 else 2e-6)


def test_the_gradient_of_the_canonical_place(anny: Body, transforms: mi.Float) -> None:
    """Against central differences in double precision."""
    rng = np.random.default_rng(2)
    body = anny.weights[rng.integers(0, len(anny.weights), 8)].astype(np.float64)
    delta, x = rng.normal(size=body.shape), rng.normal(size=(8, 3))
    adjoint = rng.normal(size=(8, 3))
    matrices = transforms.numpy().reshape(-1, 3, 4).astype(np.float64)

    def value(delta: np.ndarray) -> float:
        weights = (body + 1e-9) * np.exp(delta)
        weights /= weights.sum(axis=1, keepdims=True)
        blended = np.einsum("nj,jab->nab", weights, matrices)
        place = np.linalg.solve(blended[:, :, :3], (x - blended[:, :, 3])[..., None])[..., 0]
        return float((adjoint * place).sum())

    attached = tensor(delta)
    dr.enable_grad(attached)
    place, _ = Blended(transforms, neural_weights(tensor(body), attached)).inverse(
        mi.Point3f(np.ascontiguousarray(x.T, np.float32)))
    dr.backward(dr.sum(dr.dot(place, mi.Point3f(np.ascontiguousarray(adjoint.T, np.float32)))))
    found = dr.grad(attached).numpy().T
    step, expected = 1e-5, np.zeros_like(delta)
    for index in np.ndindex(delta.shape):
        up, down = delta.copy(), delta.copy()
        up[index] += step
        down[index] -= step
        expected[index] = (value(up) - value(down)) / (2 * step)
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_smooth_l1_of_some_points() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.dirichlet([0.3] * 5, 12), rng.dirichlet([0.3] * 5, 12)
    found = smooth_l1(every(tensor(a), 4), every(tensor(b), 4)).numpy()
    difference = np.abs(a - b)[::4]
    terms = np.where(difference < 1, 0.5 * difference**2, difference - 0.5)
    np.testing.assert_allclose(found, terms.mean(axis=1), rtol=1e-5)
