"""Findings follow from estimates."""

from __future__ import annotations

import numpy as np
import pytest

from ndf_mi.planning import findings
from ndf_mi.planning.appearance import UNKNOWN, Estimate
from ndf_mi.planning.detail import Detail
from ndf_mi.planning.plan import Finding, PlanSettings
from ndf_mi.planning.planner import full_model
from ndf_mi.planning.standoff import Disagreement, Standoff


def test_masks_with_holes_do_not_widen_the_band() -> None:
    settings, full = PlanSettings(), full_model()
    fine = Detail(0.01, 0.02, 0.01, {2: 1.0, 4: 1.0, 8: 1.0}, 1.0, 0.5)

    def about(outside: float, inside: float) -> Finding:
        beside = [Disagreement(np.full(1000, depth), np.full(1000, 1.0), np.zeros(1000, int))
                  for depth in (outside, inside)]
        return findings.about_band(Standoff(beside[0], beside[1], 5000), fine, settings, full)

    usual, hidden = about(0.02, 0.0), about(0.02, 0.2)
    assert usual.changes["band"] < 0.05
    # The density reaches no deeper than in the full model, and a band is at least as wide as it is deep.
    assert hidden.changes["band_inside"] <= full.band and hidden.changes["band"] <= 0.101


def test_the_band_reaches_what_masks_do_not_show() -> None:
    settings, full = PlanSettings(), full_model()
    fine = Detail(0.01, 0.02, 0.01, {2: 1.0, 4: 1.0, 8: 1.0}, 1.0, 0.5)

    def about(outside: float, least: float) -> Finding:
        beside = [Disagreement(np.full(1000, depth), np.full(1000, 1.0), np.zeros(1000, int))
                  for depth in (outside, 0.0)]
        return findings.about_band(Standoff(beside[0], beside[1], 5000), fine, settings, full, None, least)

    assert about(0.02, 0.05).changes["band"] == about(0.05, 0.0).changes["band"]
    assert "may be 50 mm off" in about(0.02, 0.05).evidence
    assert about(0.12, 0.05) == about(0.12, 0.0)


def test_a_part_is_kept_if_it_is_significant_and_worth_it() -> None:
    settings, full = PlanSettings(accuracy=30, worth=0.1), full_model()
    # 0.1 dB of an error of 1e-3 is 2.33e-5.
    for value, error, kept in ((3e-5, 1e-5, True), (2e-5, 1e-6, False), (1e-4, 6e-5, False)):
        for about in (findings.about_light, findings.about_view):
            finding = about(Estimate(value, error), settings, full)
            assert (not finding.left_out) == kept
    assert findings.about_view(UNKNOWN, settings, full).changes == {"direction_octaves": -1,
                                                                    "direction": "view"}
    assert findings.worth(Estimate(1e-3, 0), settings) == pytest.approx(10 * np.log10(2))


def test_the_grid_is_finer_than_a_pixel_and_no_finer_than_a_blur_that_costs_nothing() -> None:
    settings, full = PlanSettings(), full_model()

    def about(texel: float, **lost: float) -> Finding:
        of_blurs = {2: 1.0, 4: 1.0, 8: 1.0} | {int(name[1:]): value for name, value in lost.items()}
        return findings.about_detail(Detail(0.01, 0.02, texel, of_blurs, 1.0, 0.5), settings, full)

    coarse, fine, plain = about(0.01), about(0.0034), about(0.01, _2=0.0)
    # Two thirds of a pixel, within the rounding to whole octets of cells.
    assert 100 < coarse.changes["grid_finest"] <= 158 < 400 < fine.changes["grid_finest"] <= full.grid_finest
    assert plain.changes["grid_finest"] <= 83
    assert plain.changes["grid_levels"] < coarse.changes["grid_levels"] < full.grid_levels
    assert "0 levels" not in fine.left_out and "level" in coarse.left_out and not about(0.001).left_out
