"""All convolutions together, held against dense ones by SciPy that are masked to the sites."""

import drjit as dr
import mitsuba as mi
import numpy as np
from dense_convolution import correlated, dense

from ndf_mi.methods.neural_body.architecture import Architecture
from ndf_mi.methods.neural_body.encoder import Encoder, padded, place
from ndf_mi.methods.neural_body.voxels import voxels

SHAPE = (16, 16, 24)
SMALL = Architecture(code=3, channels=(4, 5, 3), depths=(2, 1, 1))


def expected(found, weights, codes):
    """The features at strides 2 and 4."""
    x = np.stack([codes[found.site == site].mean(0) for site in range(len(found.count))])
    offset, features = 0, {}
    for number, inputs, outputs, down in [(0, 3, 4, False), (0, 4, 4, False), (1, 4, 5, True),
                                          (1, 5, 5, False), (2, 5, 3, True), (2, 3, 3, False)]:
        size = 27 * inputs * outputs
        matrix = weights[offset : offset + size].reshape(-1, outputs)
        scale, shift = weights[offset + size : offset + size + 2 * outputs].reshape(2, -1)
        offset += size + 2 * outputs
        stride = found.strides[number]
        grid = correlated(dense(x, found.strides[number - down]), matrix)
        y = grid[tuple(stride.sites.T * (1 + down))]
        x = np.maximum((y - y.mean(0)) / np.sqrt(y.var(0) + 1e-3) * scale + shift, 0)
        features[number] = x
    assert offset == len(weights)
    return [features[1], features[2]]


def test_features_are_those_of_dense_convolutions():
    rng = np.random.default_rng(0)
    found = voxels(rng.uniform(0, 1, (80, 3)) * (np.array(SHAPE) - 1), SHAPE, 3)
    encoder, codes = Encoder(SMALL), rng.normal(size=(80, 3))
    weights = encoder.initial(rng) + rng.normal(0, 0.1, encoder.size)
    weights = weights.astype(np.float32)
    for rows in ((0, 0, 0), (200, 300, 100)):
        features = encoder(mi.Float(weights), mi.Float(codes.ravel()), place(found, rows))
        for values, right in zip(features, expected(found, weights.astype(float), codes), strict=True):
            ours = values.numpy().reshape(-1, right.shape[1])[: len(right)]
            np.testing.assert_allclose(ours, right, rtol=1e-3, atol=1e-3)


def test_gradients_agree_with_differences():
    rng = np.random.default_rng(1)
    found = voxels(rng.uniform(0, 1, (80, 3)) * (np.array(SHAPE) - 1), SHAPE, 3)
    encoder, on = Encoder(SMALL), place(found, (0, 0, 0))
    values = {"weights": encoder.initial(rng), "codes": rng.normal(size=240).astype(np.float32)}
    sites = [len(stride.sites) for stride in found.strides[1:]]
    sent = [rng.normal(size=count * width) for count, width in zip(sites, (5, 3), strict=True)]

    arrays = {name: mi.Float(value) for name, value in values.items()}
    dr.enable_grad(*arrays.values())
    total = mi.Float(0)
    for feature, vector in zip(encoder(arrays["weights"], arrays["codes"], on), sent, strict=True):
        lane = dr.arange(mi.UInt32, len(vector))
        total = total + dr.sum(dr.gather(mi.Float, feature, lane) * mi.Float(vector))
    dr.backward(total)
    for name in values:
        step = dr.grad(arrays[name]).numpy().astype(float)
        step *= 1e-3 / np.linalg.norm(step)
        slope = 0.0
        for sign in (1, -1):
            moved = {**values, name: values[name] + sign * step}
            features = expected(found, moved["weights"].astype(float), moved["codes"].reshape(-1, 3))
            slope += sign * sum(feature.ravel() @ vector
                                for feature, vector in zip(features, sent, strict=True)) / 2
        np.testing.assert_allclose(dr.grad(arrays[name]).numpy().astype(float) @ step, slope, rtol=2e-2)


def test_sizes_are_few():
    sizes = {padded(count) for count in range(1, 10_000)}
    assert len(sizes) < 60 and all(count <= padded(count) < 1.25 * count + 64 for count in range(1, 10_000))
