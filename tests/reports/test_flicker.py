"""Temporal consistency in a report."""

import dataclasses

import pytest

from ndf_mi.reports.flicker import SMOOTH, flicker_section


def test_every_method_has_a_line_and_a_strip(results, truth, tmp_path):
    section = flicker_section(results, truth, tmp_path)
    chart, sequence = section.charts[0], section.sequences[0]
    assert len(section.charts) == len(section.sequences) == 1
    assert all(method.label in chart.alt for method in results.methods)
    assert sequence.title == "Novel poses" and len(sequence.strips) == 1 + len(results.methods)
    for strip, method in zip(sequence.strips[1:], results.methods, strict=True):
        first, second = (picture for panel in strip.panels for picture in panel)
        assert first.label == "3 → 4" and second.label == "4 → 5"
        assert method.label.partition(",")[0] in strip.title
        # The first pair's figure, and none of the second, where the body is out of sight.
        assert first.caption != second.caption == "– dB"
    assert "23.00 dB" in sequence.strips[1].panels[0][0].alt


def test_a_constant_error_is_no_flicker(results, truth, tmp_path):
    section = flicker_section(results, truth, tmp_path)
    changes, *errors = (
        float(strip.panels[0][0].alt.split("mean ")[1].split(",")[0]) for strip in section.sequences[0].strips
    )
    # One channel of three changes by 0.1 from frame to frame. Pictures are rounded to 8 bits.
    assert changes == pytest.approx(0.1 / 3, abs=1e-3)
    assert all(error < 2 / 255 for error in errors)


def test_the_description_has_the_motion_and_the_still_picture(results, truth, tmp_path):
    description = flicker_section(results, truth, tmp_path).sequences[0].description
    for text in ("side", "3 frames from 3 to 5", "10 mm", "21.50 dB"):
        assert text in description
    vertices = truth.poses.vertices + 2 * SMOOTH / 1000 * truth.poses.frames[:, None, None]
    fast = type(truth)(**vars(truth) | {"poses": dataclasses.replace(truth.poses, vertices=vertices)})
    assert len(flicker_section(results, fast, tmp_path).sequences[0].description) > len(description) + 20


def test_without_sequences_there_is_no_section(results, truth, tmp_path):
    results.methods[0].flicker = []
    assert flicker_section(results, truth, tmp_path) is None
