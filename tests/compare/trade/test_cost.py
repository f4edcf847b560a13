"""The model of time and error against a machine and an error that are known."""

import math

import pytest

from ndf_mi.compare.trade.cost import CostModel, Sample, Sight
from ndf_mi.compare.trade.setting import Setting
from ndf_mi.render.image import LANES
from ndf_mi.render.sampling import QUANTUM, rounded

FIXED, TILE, LANE, EVALUATED = 0.07, 0.004, 20e-9, 900e-9


def sample(samples, cutoff, rays, with_error=True):
    """A view of a machine with those costs, in which half of all candidates are looked at and a tenth is evaluated."""
    tile = min(LANES // (samples // 4), rounded(rays, QUANTUM))
    tiles = sum(math.ceil(share * rays / tile) for share in (1, 1 / 3, 1 / 3, 1 / 3))
    lanes, evaluated = tiles * tile * samples / 4, 0.1 * rays * samples
    seconds = FIXED + TILE * tiles + LANE * lanes + EVALUATED * evaluated
    error = 3.0 * samples**-2.0 * (1 if cutoff < 1e-3 else 4) if with_error else None
    return Sample(samples, cutoff, rays, tiles, lanes, 0.5 * rays * samples, evaluated, seconds, error)


@pytest.fixture(scope="module")
def model():
    known = [sample(n, c, 9000) for c in (1e-4, 1e-2) for n in (8, 32, 128)]
    return CostModel([*known, *(sample(n, 1e-4, 40000, False) for n in (16, 64, 256))], strata=1)


@pytest.mark.parametrize(("samples", "rays"), [(4, 9000), (48, 5000), (200, 40000), (512, 150000)])
def test_times_between_and_beyond_what_was_measured(model, samples, rays):
    assert model.seconds(Setting(samples, 1e-4), Sight(rays)) == pytest.approx(sample(samples, 1e-4, rays).seconds, rel=0.03)
    assert max(abs(model.residuals)) < 1e-6


def test_more_rays_a_pixel_repeat_all_but_what_is_fixed(model):
    once, thrice = (model.seconds(Setting(64, 1e-4, spp=n), Sight(20000)) for n in (1, 3))
    assert thrice - FIXED == pytest.approx(3 * (once - FIXED), rel=1e-6)


def test_a_view_with_more_of_the_performer_takes_longer(model):
    usual, full = (model.seconds(Setting(256, 1e-4), Sight(40000, evaluated=f)) for f in (1.0, 2.0))
    assert full - usual == pytest.approx(EVALUATED * 0.1 * 40000 * 256, rel=0.02)


@pytest.mark.parametrize("samples", [4, 8, 20, 128, 512])
def test_errors_follow_their_power(model, samples):
    for cutoff, factor in ((1e-4, 1), (1e-2, 4)):
        assert model.error(Setting(samples, cutoff)) == pytest.approx(3.0 * factor * samples**-2.0, rel=1e-3)


def test_more_samples_never_count_as_worse():
    noisy = [Sample(n, 0.01, 100, 4, 100 * n, 50 * n, 10 * n, 0.1, error) for n, error in ((8, 1e-2), (16, 1e-3), (32, 2e-3))]
    model = CostModel(noisy, 1)
    assert model.error(Setting(32, 0.01)) == pytest.approx(1e-3) == model.error(Setting(512, 0.01))
