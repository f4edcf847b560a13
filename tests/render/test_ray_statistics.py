"""Estimates of an image's work from a few rays: against counts by hand and against rendered images."""

import numpy as np
import pytest

from ndf_mi.capture.camera import framing
from ndf_mi.render.ray_statistics import ROUNDS, RayStatistics, probe
from ndf_mi.render.settings import Setting


def test_counts_where_two_thirds_of_the_rays_end():
    """9,000 rays fit one tile of 12,288. A third of them continues after the first round; a fifth of all
    candidates is evaluated."""
    before = np.ones((ROUNDS, 30))
    before[1:, np.arange(30) % 3 > 0] = 5e-3
    statistics = RayStatistics(9000, 1, np.full((ROUNDS, 30), 0.2), before)
    found = statistics.counts(Setting(64, 1e-2))
    assert (found.tiles, found.lanes) == (4, 4 * 12288 * 16)
    assert found.evaluated == pytest.approx(0.2 * 16 * (9000 + 3 * 3000))
    # Arrays hold 2,048 times 1, 3/2, 2, 3, 4, 6 and so on: 28,800 samples take 32,768 lanes, 9,600 take
    # 12,288.
    assert found.launched == 32768 + 3 * 12288
    # With a cutoff below their transmittance, or none, no ray ends.
    assert (
        statistics.counts(Setting(64, 1e-3)).launched == statistics.counts(Setting(64, 0.0)).launched
        == 4 * 32768)
    # With 128 samples in a round, a tile has 4,096 rays.
    many = RayStatistics(150000, 1, statistics.evaluated, before).counts(Setting(512, 1e-2))
    assert many.tiles == 37 + 3 * 13 and many.evaluated == pytest.approx(0.2 * 128 * (150000 + 3 * 50000))


def test_samples_are_counted_in_the_tile_that_they_are_in():
    """Only the first half of 32,768 rays in two tiles meets anything: the other tile takes the smallest array
    there is."""
    evaluated = np.zeros((ROUNDS, 64))
    evaluated[:, :32] = 0.25
    found = RayStatistics(32768, 1, evaluated, np.ones((ROUNDS, 64))).counts(Setting(128, 0.0))
    assert found.tiles == 8 and found.launched == pytest.approx(4 * ((131072 + 131072 + 196608) / 3 + 2048))


def test_counts_agree_with_those_of_images(trained_run):
    run = trained_run
    frame = int(run.poses.frames[0])
    camera = framing(run.poses.vertices[0], 112, 112)
    statistics = probe(run.posed(frame), camera)
    for samples in (20, 112, 160):
        for cutoff in (0.0, 1e-4, 1e-2, 0.1):
            setting = Setting(samples, cutoff)
            work, predicted = setting.image(run, frame, camera).work, statistics.counts(setting)
            assert work.rays == statistics.rays and predicted.lanes == pytest.approx(work.lanes, rel=0.1)
            assert predicted.evaluated == pytest.approx(work.evaluated, rel=0.05)
            assert predicted.launched == pytest.approx(work.launched, rel=0.1)


def test_settings_of_other_rounds_are_refused():
    with pytest.raises(ValueError, match="3 rounds"):
        RayStatistics(100, 1, np.zeros((ROUNDS, 4)), np.ones((ROUNDS, 4))).counts(Setting(9))


def test_an_empty_view_takes_nothing(trained_run):
    camera = framing(trained_run.poses.vertices[0] + 50, 16, 16)
    found = probe(trained_run.posed(int(trained_run.poses.frames[0])), camera).counts(Setting(64))
    assert (found.tiles, found.lanes, found.evaluated, found.launched) == (0, 0, 0.0, 0.0)
