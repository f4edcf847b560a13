"""What a picture asks of the machine, found by looking at few of its rays: against counts by hand, and against those of pictures."""

import numpy as np
import pytest

from ndf_mi.capture.viewpoint import framing
from ndf_mi.render.ray_statistics import ROUNDS, Sight, look
from ndf_mi.render.settings import Setting


def test_counts_of_rays_of_which_two_thirds_end():
    """9,000 rays are one tile of 12,288; a third of them is left after the first round, and a fifth of all samples is evaluated."""
    before = np.ones((ROUNDS, 30))
    before[1:, np.arange(30) % 3 > 0] = 5e-3
    view = Sight(9000, 1, np.full((ROUNDS, 30), 0.2), before)
    found = view.counts(Setting(64, 1e-2))
    assert (found.tiles, found.lanes) == (4, 4 * 12288 * 16)
    assert found.evaluated == pytest.approx(0.2 * 16 * (9000 + 3 * 3000))
    # Arrays hold 2,048 times 1, 3/2, 2, 3, 4, 6 and so on: 28,800 samples take 32,768 lanes, 9,600 take 12,288.
    assert found.launched == 32768 + 3 * 12288
    # Rays followed further than those that end are all there in every round.
    assert view.counts(Setting(64, 1e-3)).launched == view.counts(Setting(64, 0.0)).launched == 4 * 32768
    # Larger pictures are cut into tiles of 4,096 rays, with 128 samples each.
    many = Sight(150000, 1, view.evaluated, before).counts(Setting(512, 1e-2))
    assert many.tiles == 37 + 3 * 13 and many.evaluated == pytest.approx(0.2 * 128 * (150000 + 3 * 50000))


def test_what_is_evaluated_is_where_it_is_seen():
    """Of 32,768 rays in two tiles only the first half meets anything: one tile is empty, which takes the least array there is."""
    evaluated = np.zeros((ROUNDS, 64))
    evaluated[:, :32] = 0.25
    found = Sight(32768, 1, evaluated, np.ones((ROUNDS, 64))).counts(Setting(128, 0.0))
    assert found.tiles == 8 and found.launched == pytest.approx(4 * ((131072 + 131072 + 196608) / 3 + 2048))


def test_counts_agree_with_those_of_pictures(trained_run):
    run = trained_run
    frame = int(run.poses.frames[0])
    camera = framing(run.poses.vertices[0], 112, 112)
    view = look(run.posed(frame), camera)
    for samples in (20, 112, 160):
        for cutoff in (0.0, 1e-4, 1e-2, 0.1):
            setting = Setting(samples, cutoff)
            work, believed = setting.image(run, frame, camera).work, view.counts(setting)
            assert work.rays == view.rays and believed.lanes == pytest.approx(work.lanes, rel=0.1)
            assert believed.evaluated == pytest.approx(work.evaluated, rel=0.05)
            assert believed.launched == pytest.approx(work.launched, rel=0.1)


def test_other_rounds_than_those_looked_at_are_refused():
    with pytest.raises(ValueError, match="3 rounds"):
        Sight(100, 1, np.zeros((ROUNDS, 4)), np.ones((ROUNDS, 4))).counts(Setting(9))


def test_nothing_in_view_takes_nothing(trained_run):
    camera = framing(trained_run.poses.vertices[0] + 50, 16, 16)
    found = look(trained_run.posed(int(trained_run.poses.frames[0])), camera).counts(Setting(64))
    assert (found.tiles, found.lanes, found.evaluated, found.launched) == (0, 0, 0.0, 0.0)
