"""Temporal consistency of pictures whose changes are known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from PIL import Image

from ndf_mi.capture.document import Split
from ndf_mi.experiments.flicker import choose_sequences, measure_flicker
from ndf_mi.experiments.records import FrameSequence


def write(folder, sequence, images):
    for view, image in zip(sequence.views, images, strict=True):
        (folder / view.file).parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)).save(folder / view.file)


@pytest.fixture
def sequence(capture, monkeypatch):
    """All three frames of a training camera; the sphere moves between them."""
    monkeypatch.setitem(capture.splits, "train", Split(("c0",), (2, 5)))
    return FrameSequence("train", "c0", (2, 5))


def test_the_truth_has_no_error(capture, sequence, tmp_path):
    write(tmp_path, sequence, [capture.image("c0", frame) for frame in sequence.frames])
    flicker = measure_flicker(capture, sequence, tmp_path)
    assert flicker.tpsnr == [math.inf]
    # The sphere moves by 11 cm, a sixth of the picture: a frozen picture is far from right.
    assert 10 < flicker.frozen[0] < 25


def test_a_frozen_picture_has_the_error_of_no_change(capture, sequence, tmp_path):
    write(tmp_path, sequence, [capture.image("c0", 2)] * 2)
    flicker = measure_flicker(capture, sequence, tmp_path)
    assert flicker.tpsnr == flicker.frozen


def test_a_still_error_is_free_and_a_flickering_one_is_not(capture, sequence, tmp_path):
    truth = [capture.image("c0", frame) for frame in sequence.frames]
    # 10 of 255 levels, added where they clip nothing: 0.2 … 0.8 are all the colours there are.
    step = np.float32(10 / 255)
    write(tmp_path, sequence, [image + step for image in truth])
    # Nothing but the rounding of single precision is left, 1e-7.
    assert measure_flicker(capture, sequence, tmp_path).tpsnr[0] > 130
    write(tmp_path, sequence, [truth[0] + step, truth[1] - step])
    # The change is wrong by 20 levels everywhere: −20·log10(20/255) = 22.1102 dB, 6.02 dB below the PSNR of
    # each frame.
    assert measure_flicker(capture, sequence, tmp_path).tpsnr == [pytest.approx(22.1102, abs=1e-3)]


def test_independent_noise_is_three_decibels_below_psnr(capture, sequence, tmp_path):
    rng = np.random.default_rng(0)
    truth = [capture.image("c0", frame) for frame in sequence.frames]
    write(tmp_path, sequence, [image + rng.normal(0, 0.05, image.shape) for image in truth])
    psnr = -20 * math.log10(0.05)
    assert measure_flicker(capture, sequence, tmp_path).tpsnr[0] == pytest.approx(
        psnr - 10 * math.log10(2), abs=0.2
    )


def test_both_boxes_count(capture, sequence, tmp_path):
    """An error where the performer was, and is no more, is seen."""
    from ndf_mi.experiments import metrics

    truth = [capture.image("c0", frame) for frame in sequence.frames]
    masks = [
        metrics.box_mask(capture.cameras["c0"], capture.poses.vertices[capture.poses.index(f)])
        for f in (2, 5)
    ]
    left = masks[0] & ~masks[1]
    assert left.any()
    ghost = truth[1].copy()
    ghost[left] += np.float32(51 / 255)
    write(tmp_path, sequence, [truth[0], ghost])
    # 51 levels are 0.2: its square, over the share of the union's pixels that have it.
    expected = -10 * math.log10(0.04 * left.sum() / (masks[0] | masks[1]).sum())
    assert measure_flicker(capture, sequence, tmp_path).tpsnr == [pytest.approx(expected, abs=1e-4)]


def test_out_of_sight_is_not_defined(capture, sequence, tmp_path, monkeypatch):
    write(tmp_path, sequence, [capture.image("c0", frame) for frame in sequence.frames])
    away = dataclasses.replace(capture.poses, vertices=capture.poses.vertices + np.float32([0, 100, 0]))
    monkeypatch.setattr(capture, "poses", away)
    assert measure_flicker(capture, sequence, tmp_path).tpsnr == [None]


def test_sequences_are_the_closest_frames_of_the_first_camera(capture, monkeypatch):
    monkeypatch.setitem(capture.splits, "novel_view", Split(("n1", "n0"), (0, 10, 20, 22, 24, 30, 32, 34)))
    monkeypatch.setitem(capture.splits, "novel_pose", Split(("n0",), (7,)))
    chosen = {sequence.split: sequence for sequence in choose_sequences(capture, 3)}
    assert chosen["novel_view"] == FrameSequence("novel_view", "n1", (20, 22, 24))
    assert chosen["novel_view"].spacing == 2
    assert "novel_pose" not in chosen and chosen["train"].frames == (2, 5) and chosen["train"].spacing == 3
    assert [view.file for view in chosen["train"].views] == ["train/c0/000002.png", "train/c0/000005.png"]
    assert len({s.split: s for s in choose_sequences(capture, 100)}["novel_view"].frames) == 8
    assert choose_sequences(capture, 0) == []


def test_a_split_made_for_it_is_the_only_one_taken(capture, monkeypatch):
    monkeypatch.setitem(capture.splits, "sequence", Split(("n0",), (0, 2, 5)))
    assert choose_sequences(capture, 12) == [FrameSequence("sequence", "n0", (0, 2, 5))]
    assert choose_sequences(capture, 0) == []
