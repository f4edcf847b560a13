"""Sparse convolutions and their gradients, held against dense ones by SciPy in double precision."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from dense_convolution import correlated, dense
from scipy import ndimage

from ndf_mi.methods.neural_body.convolution import convolve, normalise
from ndf_mi.methods.neural_body.voxels import voxels

SHAPE = (8, 12, 16)
INPUTS, OUTPUTS = 3, 4


@pytest.fixture(scope="module")
def found():
    rng = np.random.default_rng(1)
    return voxels(rng.uniform(0, 1, (90, 3)) * (np.array(SHAPE) - 1), SHAPE, 2)


@pytest.mark.parametrize("down", [False, True])
def test_values_and_gradients_are_those_of_a_dense_convolution(found, down):
    rng = np.random.default_rng(2)
    before, after = found.strides[0], found.strides[int(down)]
    window, step = (after.down, 2) if down else (after.same, 1)
    x, weight = rng.normal(size=(len(before.sites), INPUTS)), rng.normal(size=(27 * INPUTS, OUTPUTS))
    sent = rng.normal(size=(len(after.sites), OUTPUTS))
    at = tuple(after.sites.T * step)

    flat, matrix = mi.Float(x.ravel()), mi.TensorXf(weight)
    dr.enable_grad(flat, matrix)
    y = convolve(flat, matrix, mi.Int32(window.inputs.ravel()), mi.Int32(window.outputs.ravel()))
    np.testing.assert_allclose(y.numpy().reshape(-1, OUTPUTS), correlated(dense(x, before), weight)[at],
                               rtol=1e-4, atol=1e-4)

    # The dense convolution is linear in both: its derivatives are convolutions of what was sent back.
    dr.backward(dr.sum(y * mi.Float(sent.ravel())))
    back = np.zeros((*before.shape, OUTPUTS))
    back[at] = sent
    kernel = weight.reshape(3, 3, 3, INPUTS, OUTPUTS)
    in_x = np.stack([sum(ndimage.convolve(back[..., o], kernel[..., c, o], mode="constant")
                         for o in range(OUTPUTS)) for c in range(INPUTS)], -1)[tuple(before.sites.T)]
    np.testing.assert_allclose(dr.grad(flat).numpy().reshape(-1, INPUTS), in_x, rtol=1e-4, atol=1e-4)
    padded = np.pad(dense(x, before), [(1, 1)] * 3 + [(0, 0)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3, 3), axis=(0, 1, 2))
    in_weight = np.einsum("xyzcijk,xyzo->ijkco", windows, back).reshape(weight.shape)
    np.testing.assert_allclose(dr.grad(matrix).numpy(), in_weight, rtol=1e-4, atol=1e-4)


def test_padding_changes_nothing(found):
    rng = np.random.default_rng(3)
    stride = found.strides[0]
    rows, more = len(stride.sites), 7
    x, weight = rng.normal(size=(rows, INPUTS)), rng.normal(size=(27 * INPUTS, OUTPUTS))

    def run(padding):
        table = np.concatenate([stride.same.inputs, np.full((padding, 27), -1, np.int32)])
        back = np.concatenate([stride.same.outputs, np.full((padding, 27), -1, np.int32)])
        flat = mi.Float(np.concatenate([x, np.full((padding, INPUTS), 9.0)]).ravel())
        mean = np.zeros((1, rows + padding), np.float32)
        mean[:, :rows] = 1 / rows
        dr.enable_grad(flat)
        y = convolve(flat, mi.TensorXf(weight), mi.Int32(table.ravel()), mi.Int32(back.ravel()))
        y = normalise(y, mi.Float([1, 2, 3, 4]), mi.Float([0.1] * 4), mi.TensorXf(mean))
        dr.backward(dr.sum(dr.square(dr.gather(mi.Float, y, dr.arange(mi.UInt32, rows * OUTPUTS)))))
        return y.numpy()[: rows * OUTPUTS], dr.grad(flat).numpy()[: rows * INPUTS]

    for one, other in zip(run(0), run(more), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-4, atol=1e-4)


def test_normalisation_and_its_gradient():
    rng = np.random.default_rng(4)
    x = 5 + 2 * rng.normal(size=(200, 3))
    scale, shift = np.array([1.0, -0.5, 2.0]), np.array([0.3, 0.2, -0.1])
    sent = rng.normal(size=x.shape)

    def expected(x, scale, shift):
        centred = x - x.mean(0)
        return np.maximum(centred / np.sqrt(centred.var(0) + 1e-3) * scale + shift, 0)

    flat, factors, added = mi.Float(x.ravel()), mi.Float(scale), mi.Float(shift)
    dr.enable_grad(flat, factors, added)
    y = normalise(flat, factors, added, mi.TensorXf(np.full((1, 200), 1 / 200, np.float32)))
    np.testing.assert_allclose(y.numpy().reshape(x.shape), expected(x, scale, shift), rtol=1e-4, atol=1e-4)
    dr.backward(dr.sum(y * mi.Float(sent.ravel())))

    def slope(*moves):
        plus, minus = (expected(*(value + sign * move for value, move in
                                  zip((x, scale, shift), moves, strict=True))) for sign in (1, -1))
        return (sent * (plus - minus)).sum() / 2

    for row, column in ((0, 0), (50, 1), (199, 2)):
        step = np.zeros_like(x)
        step[row, column] = 1e-5
        np.testing.assert_allclose(dr.grad(flat).numpy().reshape(x.shape)[row, column],
                                   slope(step, 0, 0) / 1e-5, rtol=1e-2, atol=1e-3)
    for column, step in enumerate(1e-5 * np.eye(3)):
        np.testing.assert_allclose(dr.grad(factors).numpy()[column], slope(0, step, 0) / 1e-5, rtol=1e-3)
        np.testing.assert_allclose(dr.grad(added).numpy()[column], slope(0, 0, step) / 1e-5, rtol=1e-3)
