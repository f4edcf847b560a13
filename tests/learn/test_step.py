"""A training step is a function of parameters and a batch, and its loss has the gradients that differences
show."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.field import FieldParameters, preset
from ndf_mi.learn.batch import BatchSampler
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.step import QuadratureStep
from ndf_mi.run import Run

OPTIONS = TrainingOptions(surface="body", rays=128, samples=16, min_transmittance=0.0)


@pytest.fixture(scope="module")
def run(capture, tmp_path_factory):
    small = dataclasses.replace(preset("tiny"), band_inside=0.08, density_bias=0.0)
    return Run.create(tmp_path_factory.mktemp("step") / "run", small, capture.body, capture.poses, 1,
                      background=[0.2, 0.3, 0.4])


@pytest.fixture(scope="module")
def batch(capture, run):
    return BatchSampler(capture, OPTIONS, 1, capture.poses)(np.random.default_rng(0), edge_active=True)


def test_nothing_is_left_behind(run, batch):
    step = QuadratureStep(run, OPTIONS, None)
    before = run.field_tensors()
    first, _ = step(run.parameters, batch)
    other, _ = step(FieldParameters(run.parameters.weights + 0.1, run.parameters.grid), batch)
    again, statistics = step(run.parameters, batch)
    assert float(first[0]) == float(again[0]) != float(other[0])
    assert 0 < statistics.evaluated <= OPTIONS.rays * OPTIONS.samples
    assert float(statistics.error[0]) < float(again[0])
    assert not dr.grad_enabled(run.parameters.weights)
    for key, value in run.field_tensors().items():
        np.testing.assert_array_equal(value, before[key])


def test_gradients_are_those_of_differences(run, batch):
    step = QuadratureStep(run, OPTIONS, None)
    rng = np.random.default_rng(0)

    def loss_at(name, value):
        return step(run.parameters.replace(**{name: mi.Float(value.astype(np.float32))}), batch)[0][0]

    for name, value in run.parameters.arrays().items():
        attached = mi.Float(value)
        dr.enable_grad(attached)
        dr.backward(step(run.parameters.replace(**{name: attached}), batch)[0])
        gradient = dr.grad(attached).numpy().astype(np.float64)
        # Mostly along the gradient, so that float32 losses differ by more than their rounding.
        along = gradient / np.linalg.norm(gradient)
        along += 0.3 * rng.normal(size=along.size) / np.sqrt(along.size)
        size = 1e-2
        low, high = (float(loss_at(name, value + s * along)) for s in (-size, size))
        assert (high - low) / (2 * size) == pytest.approx(gradient @ along, rel=0.02)
