"""The grid of where a field is dense."""

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field.occupancy import Occupancy


def points(n=20_000, seed=0):
    return np.random.default_rng(seed).random((3, n)).astype(np.float32)


def test_everything_is_kept_at_first_and_what_stays_empty_is_not():
    occupancy = Occupancy(threshold=2.0, resolution=(8, 8, 4))
    u = points()
    kept, weight = occupancy.keep(mi.Point3f(u))
    assert kept.numpy().all() and (weight.numpy() == 1).all()
    dense = u[0] < 0.5
    for step in range(400):
        sample = points(2000, step)
        occupancy.observe(mi.Point3f(sample), mi.Float(np.where(sample[0] < 0.5, 50, 0.1).astype(np.float32)),
                          mi.Bool(True))
    kept, weight = (value.numpy() for value in occupancy.keep(mi.Point3f(u)))
    assert kept[dense].all() and (weight[dense] == 1).all() and (weight[~dense] == 1
                                                                 / occupancy.explore).all()
    assert abs(kept[~dense].mean() - occupancy.explore) < 0.02
    assert np.mean(occupancy.values.numpy() > 2.0) == 0.5


def test_those_kept_stand_for_the_others_in_the_mean():
    """Kept at random with probability p and weighted by 1/p, a sum keeps its mean."""
    occupancy = Occupancy(threshold=2.0, resolution=(2, 2, 2))
    occupancy.restore(np.zeros(8), 0)
    u, total = points(4000), 0.0
    values = np.linspace(0, 1, 4000)
    for step in range(200):
        occupancy.restore(np.zeros(8), step)
        kept, weight = (value.numpy() for value in occupancy.keep(mi.Point3f(u)))
        total += (values * kept * weight).sum() / 200
    assert abs(total / values.sum() - 1) < 0.02


def test_a_cell_that_becomes_dense_is_noticed_at_once_and_forgotten_slowly():
    occupancy = Occupancy(threshold=2.0, resolution=(2, 2, 2))
    occupancy.restore(np.zeros(8), 0)
    u = mi.Point3f(0.25, 0.25, 0.25)
    occupancy.observe(u, mi.Float(100.0), mi.Bool(True))
    assert occupancy.keep(u)[1].numpy()[0] == 1
    for _ in range(100):
        occupancy.observe(mi.Point3f(0.75), mi.Float(0.0), mi.Bool(True))
    assert occupancy.keep(u)[1].numpy()[0] == 1
    for _ in range(400):
        occupancy.observe(mi.Point3f(0.75), mi.Float(0.0), mi.Bool(False))
    assert occupancy.keep(u)[1].numpy()[0] > 1
    assert dr.width(occupancy.values) == 8
