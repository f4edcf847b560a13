"""Trilinear interpolation, held against SciPy's on the dense box, and its gradient against its transpose."""

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy import ndimage

from ndf_mi.methods.neural_body.interpolation import Lookup, interpolate

SHAPE, CHANNELS, PADDING = (6, 5, 8), 3, 4


def test_values_and_gradients():
    rng = np.random.default_rng(0)
    keys = np.sort(rng.choice(np.prod(SHAPE), 100, replace=False))
    values = rng.normal(size=(100, CHANNELS))
    points = rng.uniform(-2, 9, (300, 3))
    dense = np.zeros((np.prod(SHAPE), CHANNELS))
    dense[keys] = values
    expected = np.stack([ndimage.map_coordinates(dense[:, c].reshape(SHAPE), points.T, order=1,
                                                 mode="grid-constant") for c in range(CHANNELS)])

    active = rng.random(300) < 0.9
    lookup = Lookup(mi.UInt32(keys.astype(np.uint32)), SHAPE)
    features = mi.Float(np.concatenate([values.ravel(), np.full(PADDING * CHANNELS, 9.0)]))
    dr.enable_grad(features)
    place = mi.Point3f(points.T)
    found = interpolate(features, CHANNELS, lookup.corners(place, mi.Bool(active)))
    np.testing.assert_allclose(found.numpy(), np.where(active, expected, 0), rtol=1e-4, atol=1e-5)

    # f(v + w) − f(v) = f(w): the gradient of ⟨s, f(v)⟩ times w is ⟨s, f(w)⟩.
    sent, other = rng.normal(size=found.shape), rng.normal(size=dr.width(features))
    dr.backward(dr.sum((found * mi.TensorXf(sent)).array))
    moved = interpolate(mi.Float(other), CHANNELS, lookup.corners(place, mi.Bool(active))).numpy()
    np.testing.assert_allclose(dr.grad(features).numpy() @ other, (sent * moved).sum(), atol=1e-4)
    assert not dr.grad(features).numpy()[-PADDING * CHANNELS :].any()

    around = lookup.any_around(place).numpy()
    cells = np.floor(points).astype(int)
    there = np.zeros(np.array(SHAPE) + 40, bool)
    there[tuple(np.stack(np.unravel_index(keys, SHAPE)) + 20)] = True
    near = np.array([there[tuple(slice(c + 20, c + 22) for c in cell)].any() for cell in cells])
    np.testing.assert_array_equal(around, near)
