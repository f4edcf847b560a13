"""Fits of growth against powers that are known."""

import numpy as np
import pytest
from growth_fit import fit_growth

X = np.array([8.0, 16, 32, 64, 128, 256, 512])


@pytest.mark.parametrize(
    ("fixed", "factor", "exponent"), [(0.0, 2e-3, 1.0), (0.1, 1e-3, 1.0), (0.5, 1e-5, 2.0), (0.02, 0.01, 0.5)]
)
def test_finds_the_power_above_what_is_fixed(fixed, factor, exponent):
    growth = fit_growth(X, fixed + factor * X**exponent)
    assert growth.exponent == pytest.approx(exponent, abs=0.02)
    assert growth.fixed == pytest.approx(fixed, abs=0.02 * (fixed + factor * X[0] ** exponent))
    assert growth.residual < 1e-3 and not growth.level
    np.testing.assert_allclose(growth.at(X), fixed + factor * X**exponent, rtol=1e-2)
    assert f"{growth.exponent:.2f}" in growth.sentence("Time", "samples", "s")


def test_the_slope_is_that_of_the_last_decade():
    growth = fit_growth(X, X**1.5)
    assert growth.slope == pytest.approx(1.5)


def test_noise_moves_the_exponent_little_and_shows_in_the_residual():
    rng = np.random.default_rng(0)
    growth = fit_growth(X, (0.1 + 1e-3 * X) * (1 + 0.03 * rng.standard_normal(len(X))))
    assert growth.exponent == pytest.approx(1.0, abs=0.15) and 0.005 < growth.residual < 0.05


def test_a_constant_is_described_as_such():
    growth = fit_growth(X, np.full(len(X), 3.0))
    assert growth.level and "hardly changes" in growth.sentence("Memory", "frames", "MiB")


def test_a_curve_that_levels_off_is_described_as_such():
    assert "levels off" in fit_growth(X, np.minimum(3.0 * X, 300.0)).sentence("Memory", "rays", "MiB")
    assert not any(fit_growth(X, y).levels_off for y in (X**0.5, 5 + X, np.full(len(X), 3.0)))


@pytest.mark.parametrize(
    ("x", "y"), [([1, 2], [1, 2]), ([1, 2, 2], [1, 2, 3]), ([0, 1, 2], [1, 2, 3]), ([1, 2, 3], [1, 0, 3])]
)
def test_too_little_is_refused(x, y):
    with pytest.raises(ValueError, match="three or more"):
        fit_growth(x, y)
