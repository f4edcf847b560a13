"""What precedes the first step: how long the surface's fit may take, and which trainings have local bands."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from ndf_mi.capture.capture import Capture
from ndf_mi.field import preset
from ndf_mi.learn import prepare
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.prepare import Reference, record, reference, with_bands
from ndf_mi.surface.reference import ReferenceSurface


@pytest.mark.parametrize(("seconds", "budget"), [(0.0, None), (300.0, 30.0), (3600.0, 60.0)])
def test_the_fit_takes_a_tenth_of_the_time_and_a_minute_at_most(
    capture: Capture, monkeypatch: pytest.MonkeyPatch, seconds: float, budget: float | None
) -> None:
    offsets = np.full(capture.poses.vertices.shape[1:], 0.03, np.float32)
    given = []

    def fitted(capture: Capture, budget: float | None, *_: Any) -> ReferenceSurface:
        given.append(budget)
        return ReferenceSurface(capture.body, capture.poses, offsets, offsets[:, 0], 0.9, 12.0, 14)

    monkeypatch.setattr(prepare, "fit_reference", fitted)
    found = reference(capture, TrainingOptions(seconds=seconds))
    assert given == [budget] and found.kind == "offset"
    assert record(found)["surface"]["agreement"] == 0.9
    assert record(found)["surface"]["offset_max_mm"] == pytest.approx(52, abs=0.1)


def test_around_the_body_nothing_is_fitted(capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepare, "fit_reference", None)
    found = reference(capture, TrainingOptions(surface="body"))
    assert found.body is capture.body and found.kind == "body" and not found.tensors and record(found) == {}


def test_bands_are_local_where_asked_for_and_no_width_was_set(capture: Capture) -> None:
    wide = dataclasses.replace(preset("fast"), band=0.05, band_inside=0.03)
    bands = np.full((capture.poses.vertices.shape[1], 2), 0.03, np.float32)
    surface, options = Reference(capture.body, capture.poses), TrainingOptions(bands="local")
    assert with_bands(surface, bands, wide, wide, options).tensors["bands"] is bands
    assert not with_bands(surface, bands, wide, wide, dataclasses.replace(options, bands="uniform")).tensors
    for asked in ({"band": 0.1}, {"band_inside": 0.02}):
        assert not with_bands(surface, bands, wide, dataclasses.replace(wide, **asked), options).tensors
    assert not with_bands(surface, None, wide, wide, options).tensors
