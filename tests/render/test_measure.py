"""Measuring a profile, and the machine's pace, by a clock that is known."""

import itertools

import pytest

from ndf_mi.render.cost import CostModel
from ndf_mi.render.measure import CUTOFFS, MAX_PACE, PACE, Plan, measure, pace
from ndf_mi.render.settings import Setting


def clock(seconds):
    """A clock by which every image takes so long."""
    return itertools.count(step=seconds).__next__


def test_a_profile_has_all_that_the_cost_model_needs(trained_run):
    half = Setting(8, CUTOFFS[0]), PACE, Setting(16, CUTOFFS[1])
    plan = Plan(half, (Setting(32, CUTOFFS[0]),), azimuths=(30.0,), repeats=1)
    profile = measure(trained_run, (24, 32), False, lambda text: None, plan, clock(2.0))
    assert [(s.samples, s.error is None) for s in profile.samples] == [
        (8, False), (PACE.samples, False), (16, False), (32, True)]
    assert all(s.seconds == 2.0 for s in profile.samples)
    assert all(s.tiles > 0 and s.lanes > 0 and s.launched >= s.evaluated > 0 for s in profile.samples)
    # A ball of radius 0.5 in its cube, seen from nearly in front; the cube is padded.
    assert 0.2 < profile.opacity < 0.8
    model = CostModel(profile.samples)
    assert model.error(Setting(PACE.samples, CUTOFFS[0])) < model.error(Setting(8, CUTOFFS[0]))
    assert (model.coefficients >= 0).all()
    for seconds, expected in ((2.0, 1.0), (6.0, 3.0), (1e6, MAX_PACE), (1e-6, 1 / MAX_PACE)):
        assert pace(trained_run, (24, 32), False, profile, plan, clock(seconds)) == pytest.approx(expected)
