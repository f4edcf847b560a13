"""What each protocol measures of a capture, and what it refuses."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tyro

from ndf_mi.capture.document import Imported, Split
from ndf_mi.commands import main
from ndf_mi.commands.optimise import Optimise
from ndf_mi.commands.training_options import configured
from ndf_mi.errors import InputError
from ndf_mi.experiments import metrics
from ndf_mi.experiments.evaluate import choose_views
from ndf_mi.experiments.flicker import choose_sequences
from ndf_mi.experiments.protocols import DEFAULT, DYNACAP, PROTOCOLS, ZJU, named
from ndf_mi.experiments.records import View
from ndf_mi.field import PRESETS
from ndf_mi.run import Run


def layout(train=4, test=17, seen=range(60), novel=range(60, 260), background=0.0, imported=None):
    """A capture's splits without its images."""
    cameras = tuple(f"c{i:02d}" for i in range(train + test))
    held = cameras[train:]
    return SimpleNamespace(
        path=Path("capture"),
        background=np.full(3, background, np.float32),
        imported=imported,
        splits={
            "train": Split(cameras[:train], tuple(seen)), "novel_view": Split(held, tuple(seen)),
            "novel_pose": Split(held, tuple(novel)),
        },
    )


def frames(views, split):
    return sorted({view.frame for view in views if view.split == split})


def test_zju_measures_every_thirtieth_frame_of_all_test_cameras():
    views = choose_views(layout(test=19, seen=range(700, 1000), novel=range(0, 200)), None, protocol=ZJU)
    assert frames(views, "novel_view") == list(range(700, 1000, 30))
    assert frames(views, "novel_pose") == [0, 30, 60, 90, 120, 150, 180]
    held_out = [view for view in views if view.split != "train"]
    assert len(held_out) == 19 * (10 + 7) == len(set(held_out))
    assert sum(view.split == "train" for view in views) == 4


def test_a_split_thinned_out_before_is_measured_whole():
    every = layout(seen=range(60), novel=range(0))
    # The capture holds only what is measured of the novel poses: frames 60, 90, …, 240.
    every.splits["novel_pose"] = Split(every.splits["novel_pose"].cameras, tuple(range(60, 260, 30)))
    views = choose_views(every, None, protocol=ZJU)
    assert frames(views, "novel_pose") == list(range(60, 260, 30))


def test_dynacap_measures_five_cameras():
    views = choose_views(layout(10, 5, range(1000), range(1000, 2000)), None, protocol=DYNACAP)
    for split, first in (("novel_view", 0), ("novel_pose", 1000)):
        assert frames(views, split) == list(range(first, first + 1000, 30))
        assert sum(view.split == split for view in views) == 5 * 34


def test_fewer_images_are_drawn_from_the_protocols():
    capture = layout()
    part = choose_views(capture, 5, protocol=ZJU)
    assert set(part) <= set(choose_views(capture, None, protocol=ZJU))
    assert [sum(v.split == split for v in part) for split in ("novel_view", "novel_pose")] == [5, 5]


def test_the_default_takes_any_capture_and_48_images():
    tiny = layout(1, 1, range(2), range(2, 3))
    assert View("novel_pose", "c01", 2) in choose_views(tiny, None)
    views = choose_views(layout(), None, protocol=DEFAULT)
    assert [sum(v.split == split for v in views) for split in ("novel_view", "novel_pose")] == [48, 48]


def test_sequences_are_of_the_split_and_not_of_every_thirtieth_frame():
    novel = {sequence.split: sequence for sequence in choose_sequences(layout(), 12)}["novel_pose"]
    assert novel.frames == tuple(range(60, 72)) and novel.spacing == 1


CASES = {
    "training cameras": (layout(train=5), r"splits.train.cameras.*5 cameras.*4 cameras, for protocol zju"),
    "test cameras": (layout(test=4), r"splits.novel_view.cameras.*4 cameras.*at least 17"),
    "training frames": (layout(seen=range(30)), r"splits.train.frames.*30 frames.*at least 60"),
    "novel poses": (
        layout(novel=range(60, 100)), r"splits.novel_pose.frames.*40 frames.*30th makes 2.*at least 7",
    ),
    "no novel poses": (layout(novel=()), r"splits.novel_pose.frames.*0 frames"),
    "poses trained on": (
        layout(novel=range(59, 300)), r"novel_pose.frames.*frame 59, a training frame.*not trained on",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_capture_that_lacks_what_the_protocol_needs_is_refused(case):
    capture, expected = CASES[case]
    with pytest.raises(InputError, match=expected) as refused:
        choose_views(capture, None, protocol=ZJU)
    assert "--protocol default" in refused.value.repair


def test_cameras_trained_on_are_no_test_cameras():
    capture = layout()
    capture.splits["novel_view"] = Split(("c03", *capture.splits["novel_view"].cameras), tuple(range(60)))
    with pytest.raises(InputError, match="c03, a training camera"):
        ZJU.check(capture)


def test_views_of_frames_not_trained_on_are_refused():
    capture = layout()
    capture.splits["novel_view"] = Split(capture.splits["novel_view"].cameras, tuple(range(90)))
    with pytest.raises(InputError, match="frame 60, no training frame"):
        ZJU.check(capture)


def test_differences_in_training_are_noted():
    grey, black = layout(background=0.5, **OF_313), layout(**OF_313)
    assert ZJU.notes({"edge_kernel": 3}, black) == []
    kernel, background = ZJU.notes({"edge_kernel": 0}, grey)
    assert "kernel is 0" in kernel and "(0.50, 0.50, 0.50)" in background
    assert "unknown" in ZJU.notes(None, black)[0]
    assert DEFAULT.notes(None, layout(background=0.5), 3) == []
    # 17 cameras; 2 frames of the novel views and 34 of the novel poses.
    assert ZJU.notes({"edge_kernel": 5}, black, 600) == []
    (part,) = ZJU.notes({"edge_kernel": 5}, black, 40)
    assert "At most 40" in part and "34 and 578" in part


def imported(subject, names, layout="zju", scale=0.5):
    return Imported(layout, subject, tuple(names), 1, 30, scale)


def zju_order(count):
    """`count` cameras in a file's order, of which the first four of `layout` are at 0, 6, 12 and 18."""
    names = [f"c{i:02d}" for i in range(4, count)]
    for place, name in zip((0, 6, 12, 18), ("c00", "c01", "c02", "c03"), strict=True):
        names.insert(place, name)
    return names


#: All of subject 313: 21 cameras, 60 frames to train on and 1,000 of novel poses.
OF_313 = {"seen": range(60), "novel": range(60, 1060), "imported": imported("313", zju_order(21))}

DIFFERENCES = {
    "nothing": (OF_313, []),
    "thinned out as the protocol does": (OF_313 | {"novel": range(60, 1060, 30)}, []),
    "another subject's frames": (
        OF_313 | {"imported": imported("377", zju_order(21))},
        [
            "60 of the 300 training frames of subject 377",
            "2 frames of novel views are measured; the protocol measures 10",
            "34 frames of novel poses are measured; the protocol measures 7",
        ],
    ),
    "fewer novel poses": (
        OF_313 | {"novel": range(60, 260)},
        ["7 frames of novel poses are measured; the protocol measures 34"],
    ),
    "other training cameras": (
        OF_313 | {"imported": imported("313", [f"c{i:02d}" for i in range(21)])},
        [
            "training cameras are not the protocol's: c06, c12, c18 missing and c01, c02, c03 added",
            "test cameras of novel views are not", "test cameras of novel poses are not",
        ],
    ),
    "fewer test cameras": (
        OF_313 | {"imported": imported("313", zju_order(23))},
        [
            "test cameras of novel views are not the protocol's: c21, c22 missing.",
            "test cameras of novel poses",
        ],
    ),
    "another size": (
        OF_313 | {"imported": imported("313", zju_order(21), scale=1.0)},
        ["scaled by 1 from 1024² pixels; the protocol scales by 0.5"],
    ),
    "an unknown subject": (
        OF_313 | {"imported": imported("999", zju_order(21))}, ["unknown for subject '999'"],
    ),
    "another layout": (
        OF_313 | {"imported": imported("D1", zju_order(21), "dynacap")},
        ["imported from another layout, dynacap"],
    ),
    "nothing known": (OF_313 | {"imported": None}, ["does not record what it was imported from"]),
}


@pytest.mark.parametrize("case", DIFFERENCES)
def test_every_difference_from_the_subjects_protocol_is_noted(case):
    arguments, expected = DIFFERENCES[case]
    capture = layout(**arguments)
    ZJU.check(capture)
    notes = ZJU.notes({"edge_kernel": 3}, capture)
    assert len(notes) == len(expected) and all(
        words in note for words, note in zip(expected, notes, strict=True)
    ), notes


def test_differences_from_dynacaps_numbers_are_noted():
    def notes(test, seen, novel):
        capture = layout(10, test, seen, novel, imported=imported("D1", (), "dynacap", 1.0))
        DYNACAP.check(capture)
        return DYNACAP.notes({"edge_kernel": 3}, capture)

    assert notes(5, range(1000), range(1000, 2000)) == []
    more, views, poses = notes(6, range(1010), range(1010, 2010))
    assert (
        "1010 of the 1000 training frames of a sequence" in more
        and "6 cameras test novel views; the protocol has 5" in views
        and poses
    )


def advised(text):
    """Preset and options of the command in backquotes that a text recommends."""
    words = shlex.split(re.search("`ndf-mi (optimise [^`]*)`", text)[1])
    command = tyro.cli(Optimise, args=[*words[1:], "CAPTURE", "-o", "RUN"])
    return configured(command.preset or "fast", command.option)


def test_recommended_commands_can_be_typed():
    for protocol in (ZJU, DYNACAP):
        assert (
            advised(protocol.notes({"edge_kernel": 0}, layout())[0])[1].edge_kernel in protocol.edge_kernels
        )
    manual = (Path(__file__).parents[2] / "docs" / "protocols.md").read_text()
    for found in re.finditer("`ndf-mi optimise [^`]*`", manual):
        advised(found[0])


def test_headlines_name_both_data_ranges():
    for protocol in PROTOCOLS.values():
        assert set(protocol.headline) <= set(metrics.LABELS) and metrics.TEMPORAL in protocol.headline
    for protocol in (ZJU, DYNACAP):
        labels = [metrics.LABELS[key] for key in protocol.headline]
        assert "Box SSIM, data_range 1" in labels and "Box SSIM, data_range 2" in labels
    whole = [label for key, label in metrics.LABELS.items() if not key.startswith("box")]
    assert whole and all(label.startswith("Whole-image") for label in whole)


def test_a_comparison_by_a_protocol_that_the_capture_does_not_fit_leaves_with_exit_code_2(
    capture, tmp_path, capsys
):
    made = Run.create(
        tmp_path / "run", PRESETS["tiny"], capture.body, capture.poses, seed=0,
        background=capture.background.tolist(), capture={"name": capture.name, "digest": capture.digest},
        trained={"steps": 10, "seconds": 3600.0, "done": True},
    )
    made.save()
    arguments = [
        "compare", str(tmp_path / "run"), "--capture", str(capture.path), "-o", str(tmp_path / "out"),
    ]
    assert main([*arguments, "--protocol", "zju"]) == 2
    said = capsys.readouterr().err
    assert "splits.train.frames: found 2 frames; expected at least 60, for protocol zju" in said
    assert not (tmp_path / "out").exists()
    assert main([*arguments, "--protocol", "human36m"]) == 2
    assert main([*arguments, "--sequence", "1"]) == 2


def test_names(capsys):
    assert named("ours") is DEFAULT and "deprecated" in capsys.readouterr().err
    assert [named(name).name for name in PROTOCOLS] == ["default", "zju", "dynacap"]
    with pytest.raises(InputError, match="option protocol.*'human36m'.*one of default, zju, dynacap"):
        named("human36m")
