"""Choosing a setting by time or error: what is chosen, what is refused, and the command on top."""

import itertools
import json
import math

import numpy as np
import pytest
from known_profile import known_profile, statistics

from ndf_mi.capture.camera import framing
from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.render import profile
from ndf_mi.render.cost import CostModel
from ndf_mi.render.measure import CUTOFFS
from ndf_mi.render.settings import Setting
from ndf_mi.render.tuner import (
    SAMPLES,
    TOLERANCE,
    Choice,
    candidates,
    parse_decibel,
    parse_seconds,
    render_choice,
    training_error,
    within_budget,
    within_error,
)

OWN = 1e-3
"""Mean squared error of the field itself."""


@pytest.mark.parametrize(
    ("text", "seconds"), [("0.5s", 0.5), ("300ms", 0.3), ("2 min", 120.0), (".25s", 0.25)])
def test_times(text, seconds):
    assert parse_seconds(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["0.5", "0s", "-1s", "fast", "1h", "1e999s", "nans", ""])
def test_invalid_times(text):
    with pytest.raises(InputError, match="--budget"):
        parse_seconds(text)


def test_losses():
    assert parse_decibel("0.5dB") == parse_decibel("0.5 db") == 0.5
    for text in ("0.5", "0dB", "-1dB", "40"):
        with pytest.raises(InputError, match="--error"):
            parse_decibel(text)


def choices(own=OWN, slowdown=1.0):
    return candidates(CostModel(known_profile().samples), statistics(1000), own, slowdown)


@pytest.mark.parametrize("budget", [0.0508, 0.06, 0.09, 0.3])
def test_a_budget_is_used_and_not_exceeded(budget):
    best = within_budget(choices(), budget)
    assert 0.8 * budget < best.seconds <= budget
    assert not [c for c in choices() if c.seconds <= budget and c.psnr > best.psnr]


def test_more_time_never_gives_a_worse_image():
    best = [within_budget(choices(), budget) for budget in (0.06, 0.1, 0.2, 0.4, 7.0, 100.0)]
    assert all(a.psnr <= b.psnr and a.loss >= b.loss for a, b in itertools.pairwise(best))
    assert all(c.setting.spp == 1 for c in best) and best[-1].setting.samples == SAMPLES[-1]


def test_a_slower_machine_gets_fewer_samples():
    usual, slow = (within_budget(choices(slowdown=factor), 0.2) for factor in (1.0, 3.0))
    assert slow.setting.samples < usual.setting.samples and slow.seconds <= 0.2


def test_errors_that_were_not_measured_are_printed_as_bounds():
    measured, more = (within_budget(choices(), budget) for budget in (0.06, 100.0))
    assert "at least" not in measured.describe() and "at most" not in measured.describe()
    assert (
        f"at least {more.psnr:.1f} dB" in more.describe() and f"at most {more.loss:.2g} dB" in more.describe()
    )


def test_a_budget_too_small_is_refused_with_the_least_that_suffices():
    least = min(c.seconds for c in choices())
    with pytest.raises(InputError, match="at least") as caught:
        within_budget(choices(), 0.01)
    sufficient = float(caught.value.expected.split()[2])
    assert least <= sufficient <= 1.1 * least
    assert within_budget(choices(), sufficient).seconds <= sufficient


def test_an_error_takes_the_quickest_setting_within_it():
    quickest = within_error(choices(), 0.5)
    assert quickest.loss <= 0.5
    assert all(c.loss > 0.5 for c in choices() if c.seconds < quickest.seconds)
    # 10 log10(1 + (1/n²)/1e-3) = 0.5 dB at n = 90.5: the next number on offer.
    assert quickest.setting == Setting(96, CUTOFFS[0])
    with pytest.raises(InputError, match="at least"):
        within_error(choices(own=1e-9), 0.5)


def test_errors_add_as_independent_ones():
    choice, unknown = (
        next(c for c in choices(own) if c.setting == Setting(96, CUTOFFS[0])) for own in (OWN, None))
    error = 10 ** (-choice.psnr / 10)
    assert error == pytest.approx(1 / 96**2, rel=1e-3) and choice.loss == pytest.approx(
        10 * math.log10(1 + error / OWN))
    assert unknown.loss is None and unknown.psnr == choice.psnr


def test_training_error_is_that_of_the_last_rays_from_the_box(trained_run, make_run):
    last = json.loads((trained_run.path / "metrics.jsonl").read_text().splitlines()[-1])
    for opacity in (0.1, 0.9):
        assert -10 * math.log10(training_error(trained_run, opacity)) == pytest.approx(
            last["box_psnr"])
    assert training_error(make_run(), 0.5) is None


@pytest.mark.parametrize(("share", "filled"), [(0.5, 0.38), (0.5, 1.0), (0.0, 0.4), (0.9, 0.1)])
def test_training_error_of_rays_that_were_not_separated(make_run, share, filled):
    """Synthetic rays: a million pixels of the box, with errors on the performer and none on the
    background."""
    rng = np.random.default_rng(0)
    pixels = 1_000_000
    of_pixel = np.where(np.arange(pixels) < filled * pixels, rng.gamma(0.5, 2e-3, pixels), 0.0)
    rays = 400_000
    from_mask = round(share * rays)
    chosen = [rng.integers(0, round(filled * pixels), from_mask), rng.integers(0, pixels, rays - from_mask)]
    drawn = of_pixel[np.concatenate(chosen)]
    run = make_run()
    run.config["training"] = {"mask_share": share}
    log_training(run, -10 * math.log10(drawn.mean()))
    assert training_error(run, filled) == pytest.approx(of_pixel.mean(), rel=0.02)


def log_training(run, psnr=30.0):
    """Makes a run's training end with this PSNR."""
    (run.path / "metrics.jsonl").write_text(json.dumps({"step": 1, "psnr": psnr}) + "\n")


@pytest.mark.parametrize(("times", "expected", "again"), [
    ((1.0,), ("took 1 s",), False), ((9.0, 1.1), ("took 1.1 s", "9 s the first time"), False),
    ((9.0, 2.0), ("took 2 s", "2 times"), True), ((0.5,), ("took 0.5 s", "0.5 times"), True)])
def test_the_time_reported_is_that_of_a_further_frame(make_run, times, expected, again):
    """Images that took too long are rendered again; a time that is still off points to the profile."""
    run, messages = make_run(), []
    ticks = iter(
        [tick for number, time in enumerate(times) for tick in (100.0 * number, 100.0 * number + time)])
    choice = Choice(Setting(4), 1.0, 30.0, None)
    frame = int(run.poses.frames[0])
    render_choice(
        choice, run, frame, framing(run.poses.vertices[0], 8, 8), False, messages.append,
        clock=lambda: next(ticks))
    assert not list(ticks)
    assert all(text in " ".join(messages) for text in expected)
    assert any(".json" in message for message in messages) == again
    assert 2.0 / 1.0 > 1 + TOLERANCE


@pytest.fixture
def profiled_run(make_run, monkeypatch, tmp_path):
    """A run with a known profile for images of 24 × 24 pixels, in a cache of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    run = make_run()
    for geometry in (False, True):
        profile.write(profile.Key.of(run, (24, 24), geometry), known_profile(0.01, 1e-7, error=3e-2))
    return run


def render(run, tmp_path, *options):
    return main(["render", str(run.path), "-o", str(tmp_path / "a.png"), "--size", "24", "24", *options])


def test_render_within_a_budget_and_within_an_error(profiled_run, tmp_path, capsys):
    log_training(profiled_run)
    # The budget allows for a machine that is now several times slower than the profile.
    for limit in (["--budget", "1s"], ["--error", "0.5dB"]):
        assert render(profiled_run, tmp_path, *limit) == 0
        printed = capsys.readouterr()
        assert (
            "expected to take" in printed.err and "samples per ray" in printed.err and "took" in printed.err)
        assert "measuring" not in printed.err
        assert printed.out.strip() == str(tmp_path / "a.png") and (tmp_path / "a.png").exists()


@pytest.mark.parametrize(("options", "named"), [
    (["--budget", "1s", "--samples", "64"], "--samples"), (["--budget", "1s", "--spp", "4"], "--spp"),
    (["--error", "1dB", "--cutoff", "0.1"], "--cutoff"),
    (["--error", "1dB", "--networks", "fused"], "--networks"),
    (["--budget", "1s", "--stratified"], "--stratified"), (["--budget", "1s", "--error", "1dB"], "--error"),
    (["--budget", "1"], "0.5s"), (["--budget", "1us"], "0.5s"), (["--budget", "1ms"], "at least"),
    (["--error", "0.000001dB"], "at least"), (["--cutoff", "1"], "--cutoff")])
def test_invalid_limits_exit_with_code_2(profiled_run, tmp_path, capsys, options, named):
    log_training(profiled_run)
    assert render(profiled_run, tmp_path, *options) == 2
    assert named in capsys.readouterr().err and not (tmp_path / "a.png").exists()


def test_an_error_needs_the_runs_own_error(profiled_run, tmp_path, capsys):
    assert render(profiled_run, tmp_path, "--error", "1dB") == 2
    assert "metrics.jsonl" in capsys.readouterr().err
