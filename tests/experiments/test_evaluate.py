"""Which images are measured, and that measuring continues where it stopped."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.experiments.evaluate import ImageSet, Measurement, choose_views
from ndf_mi.experiments.flicker import choose_sequences, read_picture
from ndf_mi.experiments.records import FrameSequence, View
from ndf_mi.experiments.store import Store


class Shifted:
    """The truth plus a constant; it counts what it renders."""

    key, label = "shifted", "Shifted"

    def __init__(self, capture, shift: float) -> None:
        self._capture = capture
        self._shift = shift
        self.rendered: list[tuple[str, int]] = []

    def render(self, camera, frame):
        self.rendered.append((camera.name, frame))
        return self._capture.image(camera.name, frame) + np.float32(self._shift)

    def metadata(self):
        # The noise of the picture rendered last: 40 dB, then 50 dB, and so on.
        return {"seconds": 61.0, **({"noise_psnr": 30.0 + 10 * len(self.rendered)} if self.rendered else {})}

    def cache_key(self):
        return f"{self._shift}"


@pytest.fixture
def measured(capture, tmp_path):
    """Measures images with a store on disk, which is read again each time."""

    def call(method, views, sequences=()):
        images = ImageSet(capture, views, sequences)
        measurement = Measurement("m", "M", method, images, tmp_path / "pictures")
        return measurement.run(Store(tmp_path / "study.json", "test"))

    return call


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


def test_only_what_is_missing_or_stale_is_rendered(capture, measured, tmp_path):
    views, method = choose_views(capture, 2), Shifted(capture, 0.1)
    measured(method, views[:3])
    assert len(method.rendered) == 3
    result = measured(method, views)
    assert len(method.rendered) == len(views) and [image.view for image in result.images] == views
    (tmp_path / "pictures" / "m" / views[0].file).unlink()
    measured(method, views)
    assert len(method.rendered) == len(views) + 1
    other = Shifted(capture, 0.2)
    assert measured(other, views).mean("train", "psnr") < result.mean("train", "psnr")
    assert len(other.rendered) == len(views)


def test_frames_of_a_sequence_are_shared_and_do_not_count_in_the_means(capture, measured):
    views = [View("novel_view", "n0", 2)]
    sequence = FrameSequence("novel_view", "n0", (2, 5))
    images = ImageSet(capture, views, [sequence])
    assert images.rendered() == [View("novel_view", "n0", 2), View("novel_view", "n0", 5)]
    assert images.counts() == {"novel_view": 1}
    method = Shifted(capture, 0.1)
    result = measured(method, views, [sequence])
    assert method.rendered == [("n0", 2), ("n0", 5)]
    assert [image.sampled for image in result.images] == [True, False]
    assert result.mean("novel_view", "box_psnr") == result.images[0].figures["box_psnr"]
    assert [known.sequence for known in result.flicker] == [sequence]
    # A constant shift stays, up to rounding to 8 bits: −20·log10(2/255) is more than 42 dB.
    assert result.mean("novel_view", "box_tpsnr") > 42 and result.mean("train", "box_tpsnr") is None

    # An image that only the sequence needed counts when it is asked for, without being rendered again.
    both = measured(method, [*views, View("novel_view", "n0", 5)])
    assert len(method.rendered) == 2 and all(image.sampled for image in both.images) and both.flicker == []
    alone = measured(method, views)
    assert [image.view for image in alone.images] == views and alone.mean("novel_view", "box_tpsnr") is None


def test_a_result_counts_as_measured_only_if_it_is_complete(capture, measured, tmp_path):
    views, method = choose_views(capture, 1), Shifted(capture, 0.0)
    images = ImageSet(capture, views, choose_sequences(capture, 12))

    def known(of):
        store = Store(tmp_path / "study.json", "test")
        return Measurement("m", "M", of, images, tmp_path / "pictures").stored(store)

    measured(method, views)
    assert known(method) is None
    result = measured(method, views, images.sequences)
    assert known(method) == result and result.mean("train", "box_tpsnr") == math.inf
    assert known(Shifted(capture, 0.1)) is None


def test_noise_is_averaged_over_images_as_mean_squared_error(capture, measured):
    result = measured(Shifted(capture, 0.1), choose_views(capture, 1)[:2])
    assert result.metadata["noise_psnr"] == pytest.approx(-10 * math.log10((1e-4 + 1e-5) / 2))


def test_a_picture_brighter_than_white_is_white(capture, measured, tmp_path):
    measured(Shifted(capture, 5.0), [View("train", "c0", 2)])
    assert (read_picture(tmp_path / "pictures" / "m", View("train", "c0", 2)) == 1).all()
