"""Which images are measured, and that measuring goes on where it was."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.experiments.evaluate import choose_views, evaluate, to_render
from ndf_mi.experiments.flicker import choose_sequences
from ndf_mi.experiments.records import FrameSequence, MethodResult, Results, View


class Shifted:
    """The truth plus a constant, counting what it renders."""

    name = "shifted"

    def __init__(self, capture, shift: float) -> None:
        self._capture = capture
        self._shift = shift
        self.rendered: list[tuple[str, int]] = []

    def render(self, camera, frame):
        self.rendered.append((camera.name, frame))
        return self._capture.image(camera.name, frame) + np.float32(self._shift)

    def facts(self):
        return {"seconds": 61.0, "steps": 1000}


def test_views_cover_the_splits_and_grow_without_changing(capture):
    few, many = choose_views(capture, 1), choose_views(capture, 100)
    assert set(few) <= set(many)
    assert len(many) == len(set(many)) == 4 + 2 + 4
    assert {view.split for view in few} == {"novel_view", "novel_pose", "train"}


def test_a_capture_without_held_out_images_is_refused(capture, monkeypatch):
    empty = type(capture.splits["train"])((), ())
    monkeypatch.setitem(capture.splits, "novel_view", empty)
    monkeypatch.setitem(capture.splits, "novel_pose", empty)
    with pytest.raises(InputError, match="splits"):
        choose_views(capture, 4)


def test_only_what_is_missing_is_rendered(capture, tmp_path):
    views = choose_views(capture, 2)
    method, result, calls = Shifted(capture, 0.1), MethodResult("m", "M", ""), []
    evaluate(method, result, capture, views[:3], tmp_path, lambda: calls.append(len(result.images)))
    assert len(method.rendered) == 3 and calls == [1, 2, 3]
    evaluate(method, result, capture, views, tmp_path, lambda: None)
    assert len(method.rendered) == len(views)
    assert [image.view for image in result.images] == views
    (tmp_path / views[0].file).unlink()
    evaluate(method, result, capture, views, tmp_path, lambda: None)
    assert len(method.rendered) == len(views) + 1


def test_frames_of_a_sequence_are_shared_and_do_not_count_in_the_means(capture, tmp_path):
    views = [View("novel_view", "n0", 2)]
    sequence = FrameSequence("novel_view", "n0", (2, 5))
    assert to_render(views, [sequence]) == [View("novel_view", "n0", 2), View("novel_view", "n0", 5)]
    method, result, calls = Shifted(capture, 0.1), MethodResult("m", "M", ""), []
    evaluate(method, result, capture, views, tmp_path, lambda: calls.append(len(result.flicker)), [sequence])
    assert method.rendered == [("n0", 2), ("n0", 5)] and calls == [0, 0]
    assert [image.sampled for image in result.images] == [True, False]
    assert result.mean("novel_view", "box_psnr") == result.images[0].figures["box_psnr"]
    assert [known.sequence for known in result.flicker] == [sequence]
    # A constant shift stays, up to rounding to 8 bits: −20·log10(2/255) is more than 42 dB.
    assert result.mean("novel_view", "box_tpsnr") > 42 and result.mean("train", "box_tpsnr") is None

    # Without the sequence its own frame goes; asked for as an image it counts, without being rendered again if it is there.
    both = [*views, View("novel_view", "n0", 5)]
    evaluate(method, result, capture, both, tmp_path, lambda: None)
    assert len(method.rendered) == 2 and all(image.sampled for image in result.images) and result.flicker == []
    evaluate(method, result, capture, views, tmp_path, lambda: None)
    assert [image.view for image in result.images] == views
    assert result.mean("novel_view", "box_tpsnr") is None


def test_sequences_survive_the_disk(capture, tmp_path):
    result = MethodResult("m", "M", "print")
    sequences = choose_sequences(capture, 12)
    evaluate(Shifted(capture, 0.0), result, capture, choose_views(capture, 1), tmp_path, lambda: None, sequences)
    assert result.mean("train", "box_tpsnr") == math.inf
    made = Results({"command": "c"}, [result])
    made.write(tmp_path / "compare.json")
    assert Results.read(tmp_path / "compare.json") == made


def test_a_picture_brighter_than_white_is_white(capture, tmp_path):
    result = MethodResult("m", "M", "")
    evaluate(Shifted(capture, 5.0), result, capture, [View("train", "c0", 2)], tmp_path, lambda: None)
    from ndf_mi.experiments.flicker import read_picture

    assert (read_picture(tmp_path, View("train", "c0", 2)) == 1).all()
