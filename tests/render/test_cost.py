"""The cost model against a machine with known costs and a known error."""

import numpy as np
import pytest

from ndf_mi.render.cost import CostModel, Sample
from ndf_mi.render.ray_statistics import ROUNDS, RayStatistics
from ndf_mi.render.settings import Setting

FIXED, TILE, LANE, EVALUATED, LAUNCHED = 0.07, 0.004, 20e-9, 500e-9, 400e-9


def statistics(rays, evaluated=0.1, factor=1):
    """A view in which a fraction of all candidates is evaluated, and two of three rays end in the first
    part."""
    before = np.ones((ROUNDS, 30))
    before[1:, np.arange(30) % 3 > 0] = 0
    return RayStatistics(rays, factor, np.full((ROUNDS, 30), evaluated), before)


def sample(samples, cutoff, rays, with_error=True):
    """A measurement of such a view on a machine with those costs."""
    c = statistics(rays).counts(Setting(samples, cutoff))
    seconds = FIXED + TILE * c.tiles + LANE * c.lanes + EVALUATED * c.evaluated + LAUNCHED * c.launched
    error = 3.0 * samples**-2.0 * (1 if cutoff < 1e-3 else 4) if with_error else None
    return Sample(samples, cutoff, c.tiles, c.lanes, c.evaluated, c.launched, seconds, error)


@pytest.fixture(scope="module")
def model():
    known = [sample(n, c, 9000) for c in (1e-4, 1e-2) for n in (8, 40, 128)]
    return CostModel([*known, *(sample(n, 1e-4, 40000, False) for n in (16, 64, 224))])


@pytest.mark.parametrize(("samples", "rays"), [(4, 9000), (48, 5000), (200, 40000), (512, 150000)])
def test_times_between_and_beyond_what_was_measured(model, samples, rays):
    assert model.seconds(Setting(samples, 1e-4), statistics(rays)) == pytest.approx(
        sample(samples, 1e-4, rays).seconds, rel=1e-3)
    assert max(abs(model.residuals)) < 1e-6


def test_more_rays_a_pixel_repeat_all_but_what_is_fixed(model):
    once, thrice = (model.seconds(Setting(64, 1e-4, spp=n), statistics(20000)) for n in (1, 3))
    assert thrice - FIXED == pytest.approx(3 * (once - FIXED), rel=1e-6)


def test_a_view_with_more_of_the_performer_takes_longer(model):
    usual, full = (
        model.seconds(Setting(256, 1e-4), statistics(40000, evaluated)) for evaluated in (0.1, 0.2))
    more = 0.1 * 256 / 4 * (40000 + 3 * 40000 / 3)
    assert (EVALUATED + LAUNCHED) * more < full - usual < (EVALUATED + 1.5 * LAUNCHED) * more


@pytest.mark.parametrize("samples", [4, 8, 20, 128])
def test_errors_follow_their_power(model, samples):
    for cutoff, factor in ((1e-4, 1), (1e-2, 4)):
        assert model.error(Setting(samples, cutoff)) == pytest.approx(3.0 * factor * samples**-2.0, rel=1e-3)


def test_errors_of_more_samples_than_were_measured_are_bounded_by_those_of_the_most(model):
    for cutoff in (1e-4, 1e-2):
        most, more = Setting(128, cutoff), Setting(512, cutoff)
        assert model.error(more) == model.error(most) and model.beyond(more) and not model.beyond(most)


def test_more_samples_never_count_as_worse():
    noisy = [
        Sample(n, 0.01, 4, 100 * n, 10 * n, 10 * n, 0.1, error)
        for n, error in ((8, 1e-2), (16, 1e-3), (32, 2e-3))]
    model = CostModel(noisy)
    assert model.error(Setting(32, 0.01)) == pytest.approx(1e-3) == model.error(Setting(512, 0.01))
