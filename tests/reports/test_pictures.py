"""Pictures, their descriptions, error maps and rows."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from ndf_mi.experiments.records import View
from ndf_mi.reports import pictures
from ndf_mi.reports.pictures import Shot, picture_rows, spread

VIEW = View("novel_view", "side", 1)


def decoded(picture):
    source = base64.b64decode(picture.source.removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(source)))


def test_a_picture_holds_the_image_rounded_to_8_bits():
    image = np.array([[[0.0, 0.5, 1.0], [-1.0, 0.1, 2.0]]])
    assert decoded(pictures.picture(image, "alt")).tolist() == [[[0, 128, 255], [0, 26, 255]]]
    whole = np.full((2, 2, 3), 7, np.uint8)
    assert decoded(pictures.picture(whole, "alt")).tolist() == whole.tolist()


def test_error_scale_is_round_and_covers_the_errors():
    assert pictures.error_scale([]) == pictures.error_scale([np.zeros((4, 4))]) == 0.05
    assert pictures.error_scale([np.full((4, 4), 0.17)]) == 0.2
    assert pictures.error_scale([np.full((4, 4), 0.9)]) == 1.0


def test_error_maps_run_from_dark_to_bright():
    dark, bright = pictures.error_map(np.array([[0.0, 0.2]]), 0.2)[0].astype(int)
    assert dark.sum() < 20 and bright.sum() > 600
    error = pictures.absolute_error(np.zeros((1, 1, 3)), np.array([[[0.3, 0.0, -0.3]]]))
    assert error == pytest.approx(np.array([[0.2]]))


def test_the_window_holds_the_body_at_any_size(truth):
    rows, columns = pictures.body_window(truth, VIEW)
    mask = pictures.box_mask(truth, VIEW)
    assert mask[rows, columns].sum() == mask.sum() > 0 and mask[rows, columns].shape < mask.shape
    half = truth.image("side", 1)[::2, ::2].shape
    assert pictures.box_mask(truth, VIEW, half).shape == half[:2]
    assert pictures.mask_window(np.zeros((4, 6), bool)) == (slice(0, 4), slice(0, 6))


@pytest.mark.parametrize(("shape", "panels"), [((10, 20, 3), [1, 2]), ((20, 10, 3), [1, 1, 1])])
def test_error_maps_stand_below_wide_pictures_and_beside_narrow_ones(shape, panels):
    image = np.zeros(shape)
    error = np.full(shape[:2], 0.05)
    where = "camera side, frame 1, novel views"
    shots = [Shot("Truth", image, where), Shot("NDF", image, "31.00 dB", error)]
    row = pictures.view_row(shots, VIEW, 0.1)
    assert [len(panel) for panel in row.panels] == panels and row.height == max(panels)
    found = [picture for panel in row.panels for picture in panel]
    assert [picture.label for picture in found] == ["Truth", "NDF", "Error: NDF"]
    assert found[0].alt == "Truth: camera side, frame 1, novel views"
    assert "31.00 dB" in found[1].alt and "frame 1" in found[1].alt
    assert "0.050" in found[2].alt and "0.1" in found[2].alt and "0.050" in found[2].caption


def test_every_method_stands_in_every_row(results, truth, tmp_path):
    rows = picture_rows(results, truth, tmp_path)
    counts = {split: len(found) for split, found in rows.splits.items()}
    assert counts == {"Novel views": 2, "Novel poses": 1, "Training views": 1}
    for row in (row for found in rows.splits.values() for row in found):
        labels = [picture.label for panel in row.panels for picture in panel]
        shown = ["Truth", *(method.label for method in results.methods)]
        assert sorted(labels) == sorted([*shown, *(f"Error: {label}" for label in shown[1:])])
    # Errors are at most 0.1, and what rounding to 8 bits adds.
    assert rows.top == 0.2


def test_views_are_spread_over_those_that_all_methods_have(results):
    assert spread(results, "novel_view", 4) == [View("novel_view", "side", 1), View("novel_view", "side", 2)]
    # An image of a sequence alone is not sampled.
    assert spread(results, "novel_pose", 4) == [View("novel_pose", "side", 3)]
    first, second = results.methods[1].images[:2]
    results.methods[1].images.remove(first)
    assert spread(results, "novel_view", 4) == spread(results, "novel_view", 2, inner=True) == [second.view]
    assert spread(results, "sequence", 4) == []
