"""Profiles on disk: stored, found again, and measured again when stale."""

import json

import pytest
from known_profile import known_profile

from ndf_mi.render.profile import Key, load_or_measure


class Measurements:
    """Stands for :func:`ndf_mi.render.measure.measure` and counts its calls."""

    def __init__(self):
        self.count = 0

    def __call__(self, run, size, geometry, report):
        self.count += 1
        return known_profile(0.01, 1e-7, error=3e-2)


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_profile_is_stored_and_measured_again_when_stale(make_run, cache):
    run, measurements, messages = make_run(), Measurements(), []

    def get(size=(8, 8), geometry=False):
        messages.clear()
        return load_or_measure(run, size, geometry, messages.append, measurements)

    first = get()
    assert measurements.count == 1 and "none yet" in messages[0]
    assert get() == first and measurements.count == 1
    file = Key.of(run, (8, 8), False).file
    assert file.is_relative_to(cache / "ndf-mi") and json.loads(file.read_text())["key"]["size"] == [8, 8]
    get((8, 9))
    get((8, 8), True)
    assert measurements.count == 3

    run.parameters = run.parameters.replace(weights=run.parameters.weights + 0.5)
    get()
    assert measurements.count == 4 and "weights" in messages[0]
    for part, name in (("machine", "versions"), ("code", "code")):
        document = json.loads(file.read_text())
        document["key"][part] = (
            document["key"][part] | {"Versions": "other"} if part == "machine" else "other")
        file.write_text(json.dumps(document))
        get()
        assert name in messages[0]
    assert measurements.count == 6
    for text in (
        "{", "[]", '{"format": "ndf-profile", "version": 0}',
        file.read_text().replace('"opacity": 0.4', '"opacity": "x"')):
        file.write_text(text)
        get()
        assert "can't be read" in messages[0] or "another version" in messages[0]
    assert get() == first and measurements.count == 10


def test_a_profile_that_cannot_be_stored_is_used_all_the_same(make_run, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    messages = []
    assert load_or_measure(make_run(), (8, 8), False, messages.append, Measurements()).samples
    assert "not stored" in messages[-1]
