"""Choosing a setting by time or error: what is asked for, what is refused, and a profile that is kept and made anew when stale."""

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest

from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.render import profile
from ndf_mi.render import tuner as choice
from ndf_mi.render.cost import CostModel, Sample
from ndf_mi.render.profile import CUTOFFS, Key, Profile
from ndf_mi.render.ray_statistics import ROUNDS, Sight
from ndf_mi.render.settings import Setting
from ndf_mi.render.tuner import Choice, ended, parse_decibel, parse_seconds, within_budget, within_error


def sight(rays):
    """A view of whose samples a tenth is evaluated, and none of whose rays ends."""
    return Sight(rays, 1, np.full((ROUNDS, 16), 0.1), np.ones((ROUNDS, 16)))


def known_profile(fixed=0.05, each=1e-6, error=1.0):
    """A machine that takes `each` seconds a sample evaluated, and an error that falls with the square."""
    samples = []
    for rays in (9000, 40000):
        for cutoff, factor in zip(CUTOFFS, (1.0, 1.5), strict=True):
            for n in (8, 40, 128):
                c = sight(rays).counts(Setting(n, cutoff))
                seconds = fixed + each * c.evaluated
                samples.append(Sample(n, cutoff, c.tiles, c.lanes, c.evaluated, c.launched, seconds, factor * error / n**2))
    return Profile(samples, 0.4)


@pytest.mark.parametrize(("text", "seconds"), [("0.5s", 0.5), ("300ms", 0.3), ("2 min", 120.0), (".25s", 0.25)])
def test_times(text, seconds):
    assert parse_seconds(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["0.5", "0s", "-1s", "fast", "1h", "1e999s", "nans", ""])
def test_what_is_no_time(text):
    with pytest.raises(InputError, match="--budget"):
        parse_seconds(text)


def test_losses():
    assert parse_decibel("0.5dB") == parse_decibel("0.5 db") == 0.5
    for text in ("0.5", "0dB", "-1dB", "40"):
        with pytest.raises(InputError, match="--error"):
            parse_decibel(text)


def choices(own=1e-3):
    model = known_profile().model()
    view = sight(1000)
    return [Choice(s, model.seconds(s, view), *choice._believed(model.error(s), own), model.beyond(s)) for s in choice.offered(model)]


@pytest.mark.parametrize("budget", [0.0508, 0.06, 0.09, 0.3])
def test_a_time_is_filled_and_not_exceeded(budget):
    best = within_budget(choices(), budget)
    assert 0.8 * budget < best.seconds <= budget
    assert not [c for c in choices() if c.seconds <= budget and c.psnr > best.psnr]


def test_more_time_never_buys_a_worse_picture():
    """Nor more rays a pixel, which fields trained through pixels' centres are worse by; and more samples than the most are no use."""
    best = [within_budget(choices(), budget) for budget in (0.06, 0.1, 0.2, 0.4, 7.0, 100.0)]
    assert all(a.psnr <= b.psnr and a.loss >= b.loss for a, b in itertools.pairwise(best))
    assert all(c.setting.spp == 1 for c in best) and best[-1].setting.samples == choice.SAMPLES[-1]


def test_what_was_not_measured_is_told_as_a_bound(capsys):
    measured, more = (within_budget(choices(), budget) for budget in (0.06, 100.0))
    assert "at least" not in measured.told() and "at most" not in measured.told()
    assert f"at least {more.psnr:.1f} dB" in more.told() and f"at most {more.loss:.2g} dB" in more.told()


def test_too_short_a_time_says_what_the_least_is():
    least = min(c.seconds for c in choices())
    with pytest.raises(InputError, match="at least") as caught:
        within_budget(choices(), 0.01)
    said = float(caught.value.expected.split()[2])
    assert least <= said <= 1.1 * least
    assert within_budget(choices(), said).seconds <= said


def test_an_error_takes_the_quickest_that_keeps_it():
    quickest = within_error(choices(), 0.5)
    assert quickest.loss <= 0.5
    assert all(c.loss > 0.5 for c in choices() if c.seconds < quickest.seconds)
    # 10 log10(1 + (1/n²)/1e-3) = 0.5 dB at n = 90.5: the next number offered.
    assert quickest.setting == Setting(96, CUTOFFS[0])
    with pytest.raises(InputError, match="at least"):
        within_error(choices(own=1e-9), 0.5)


def test_errors_add_up_as_independent_ones():
    psnr, loss = choice._believed(1e-4, 1e-3)
    assert psnr == pytest.approx(40.0) and loss == pytest.approx(10 * math.log10(1.1))
    assert choice._believed(1e-4, None)[1] is None


def test_the_own_error_is_that_of_the_boxs_rays_which_training_ended_with(trained_run, make_run):
    last = json.loads((trained_run.path / "metrics.jsonl").read_text().splitlines()[-1])
    for opacity in (0.1, 0.9):
        assert -10 * math.log10(ended(trained_run).own(opacity)) == pytest.approx(last["box_psnr"])
    assert ended(make_run()) is None


@pytest.mark.parametrize(("share", "filled"), [(0.5, 0.38), (0.5, 1.0), (0.0, 0.4), (0.9, 0.1)])
def test_the_error_of_rays_that_are_not_told_apart_is_that_of_more_of_the_performer(make_run, share, filled):
    """Synthetic rays: a million pixels of the box, the performer's with errors, the background without."""
    rng = np.random.default_rng(0)
    pixels = 1_000_000
    of_pixel = np.where(np.arange(pixels) < filled * pixels, rng.gamma(0.5, 2e-3, pixels), 0.0)
    rays = 400_000
    from_mask = round(share * rays)
    chosen = [rng.integers(0, round(filled * pixels), from_mask), rng.integers(0, pixels, rays - from_mask)]
    drawn = of_pixel[np.concatenate(chosen)]
    run = make_run()
    run.config["training"] = {"mask_share": share}
    (run.path / "metrics.jsonl").write_text(json.dumps({"step": 1, "psnr": -10 * math.log10(drawn.mean())}) + "\n")
    assert ended(run).own(filled) == pytest.approx(of_pixel.mean(), rel=0.02)


@pytest.fixture
def counted(monkeypatch, tmp_path):
    """A cache of the test's own, and profiles that are not measured but counted."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    made = []
    monkeypatch.setattr(profile, "measure", lambda *a: made.append(a) or known_profile(0.01, 1e-7, error=3e-2))
    monkeypatch.setattr(choice, "pace", lambda *a: 1.0)
    return made


def test_a_pace_is_that_of_the_profiles_own_pictures(trained_run, monkeypatch):
    """A clock that goes by a second a picture, and now by three."""
    clock = {"now": 0.0, "each": 1.0}

    def image(self, *_):
        clock["now"] += clock["each"]
        return drawn

    frame = int(trained_run.poses.frames[0])
    drawn = profile.PACE.image(trained_run, frame, profile._camera(trained_run, frame, 0.0, (8, 8)))
    monkeypatch.setattr(Setting, "image", image)
    monkeypatch.setattr(profile.time, "perf_counter", lambda: clock["now"])
    monkeypatch.setattr(profile, "converged", lambda: Setting(64))
    monkeypatch.setattr("ndf_mi.render.image.Image.over", lambda self, background: np.zeros((8, 8, 3)))
    monkeypatch.setattr(profile.metrics, "box_mask", lambda camera, vertices: np.ones((8, 8), bool))
    measured = profile.measure(trained_run, (16, 16), False, lambda text: None)
    assert all(sample.seconds == 1.0 for sample in measured.samples)
    assert profile.pace(trained_run, (16, 16), False, measured) == pytest.approx(1.0)
    clock["each"] = 3.0
    assert profile.pace(trained_run, (16, 16), False, measured) == pytest.approx(3.0)
    clock["each"] = 1e6
    assert profile.pace(trained_run, (16, 16), False, measured) == profile.FARTHEST


def test_a_slower_machine_gets_less(trained_run, counted, monkeypatch, tmp_path):
    frame = int(trained_run.poses.frames[0])
    camera = profile._camera(trained_run, frame, 0.0, (32, 32))
    found = []
    for slower in (1.0, 3.0):
        monkeypatch.setattr(choice, "pace", lambda *a, slower=slower: slower)
        found.append(choice.choose(trained_run, frame, camera, False, lambda text: None, budget=0.05))
    assert found[1].setting.samples < found[0].setting.samples or found[1].setting.spp < found[0].setting.spp
    assert all(f.seconds <= 0.05 for f in found)


def test_a_profile_is_kept_and_made_anew_where_it_is_stale(make_run, counted, monkeypatch, tmp_path):
    run, told = make_run(), []

    def get(size=(8, 8), geometry=False):
        told.clear()
        return profile.profile_of(run, size, geometry, told.append)

    first = get()
    assert len(counted) == 1 and "none yet" in told[0]
    assert get() == first and len(counted) == 1
    file = Key.of(run, (8, 8), False).file
    assert file.is_relative_to(tmp_path / "cache" / "ndf-mi") and json.loads(file.read_text())["key"]["size"] == [8, 8]
    get((8, 9)), get((8, 8), True)
    assert len(counted) == 3

    run.parameters = run.parameters.replace(weights=run.parameters.weights + 0.5)
    get()
    assert len(counted) == 4 and "weights changed" in told[0]
    described = profile.machine.describe()
    monkeypatch.setattr(profile.machine, "describe", lambda: described | {"Versions": "another"})
    get()
    assert len(counted) == 5 and "versions changed" in told[0]
    monkeypatch.setattr(profile, "code_digest", lambda: "another")
    get()
    assert len(counted) == 6 and "code that draws changed" in told[0]
    for text in ("{", "[]", '{"format": "ndf-profile", "version": 0}', file.read_text().replace('"opacity": 0.4', '"opacity": "x"')):
        file.write_text(text)
        get()
        assert "can't be read" in told[0] or "another version" in told[0]
    assert get() == first and len(counted) == 10


def test_a_profile_that_cannot_be_kept_serves_all_the_same(make_run, counted, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    told = []
    assert profile.profile_of(make_run(), (8, 8), False, told.append).samples
    assert "not kept" in told[-1]


def test_render_in_a_time_and_within_an_error(make_run, counted, tmp_path, capsys):
    run = make_run()
    (run.path / "metrics.jsonl").write_text('{"step": 1, "psnr": 30.0}\n')
    out = tmp_path / "a.png"
    for wish in (["--budget", "20ms"], ["--error", "0.5dB"]):
        assert main(["render", str(run.path), "-o", str(out), "--size", "24", "24", *wish]) == 0
        said = capsys.readouterr()
        assert "believed to take" in said.err and "given up" in said.err and "took" in said.err
        assert said.out.strip() == str(out) and out.exists()
    assert len(counted) == 1


@pytest.mark.parametrize(("options", "words"), [
    (["--budget", "1s", "--samples", "64"], "--samples"),
    (["--budget", "1s", "--spp", "4"], "--spp"),
    (["--error", "1dB", "--cutoff", "0.1"], "--cutoff"),
    (["--error", "1dB", "--networks", "fused"], "--networks"),
    (["--budget", "1s", "--stratified"], "--stratified"),
    (["--budget", "1s", "--error", "1dB"], "--error"),
    (["--budget", "1"], "0.5s"),
    (["--budget", "1us"], "0.5s"),
    (["--budget", "1ms"], "at least"),
    (["--error", "0.000001dB"], "at least"),
    (["--cutoff", "1"], "--cutoff"),
])
def test_mistakes_are_told_with_exit_code_2(make_run, counted, tmp_path, capsys, options, words):
    run = make_run()
    (run.path / "metrics.jsonl").write_text('{"step": 1, "psnr": 30.0}\n')
    assert main(["render", str(run.path), "-o", str(tmp_path / "a.png"), "--size", "16", "16", *options]) == 2
    assert words in capsys.readouterr().err and not (tmp_path / "a.png").exists()


def test_an_error_needs_one_to_be_relative_to(make_run, counted, tmp_path, capsys):
    assert main(["render", str(make_run().path), "-o", str(tmp_path / "a.png"), "--size", "16", "16", "--error", "1dB"]) == 2
    assert "metrics.jsonl" in capsys.readouterr().err and not counted


def test_a_real_profile_has_all_that_the_model_needs(trained_run, monkeypatch):
    monkeypatch.setattr(profile, "HALF", {CUTOFFS[0]: (8, 32), CUTOFFS[1]: (16,)})
    monkeypatch.setattr(profile, "WHOLE", {CUTOFFS[0]: (32,)})
    monkeypatch.setattr(profile, "AZIMUTHS", (30.0,))
    monkeypatch.setattr(profile, "REPEATS", 1)
    made = profile.measure(trained_run, (24, 32), False, lambda text: None)
    assert [(s.samples, s.error is None) for s in made.samples] == [(8, False), (32, False), (16, False), (32, True)]
    assert all(s.seconds > 0 and s.tiles > 0 and s.lanes > 0 and s.launched >= s.evaluated > 0 for s in made.samples)
    # A ball of radius 0.5 in its cube, which is seen from nearly in front and is padded by some more.
    assert 0.2 < made.opacity < 0.8
    model: CostModel = made.model()
    assert model.error(Setting(32, CUTOFFS[0])) < model.error(Setting(8, CUTOFFS[0]))
    assert (model.coefficients >= 0).all() and dataclasses.astuple(made.samples[0])
