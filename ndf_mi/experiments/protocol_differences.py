"""How an imported capture differs from the data that publications used of its subject: sentences for a
protocol's notes.
"""

from __future__ import annotations

from collections.abc import Sequence

from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Imported
from ndf_mi.capture.readers import dynacap, zju
from ndf_mi.experiments.records import HELD_OUT, SPLITS

_WHAT = {zju.LAYOUT: "ZJU-MoCap", dynacap.LAYOUT: "DynaCap"}


def differences(layout: str, every: int, capture: Capture) -> list[str]:
    """The differences between a capture and the publications' data of its subject; empty if there are none.

    Only numbers of frames are compared: measured frames are counted from the first of a split, so equal
    numbers mean equal frames. For DynaCap, only numbers of cameras are compared too, because the publication
    names neither its cameras nor the size of its images.

    Args:
        layout: `zju.LAYOUT` or `dynacap.LAYOUT`.
        every: every n-th frame of a held-out split is measured.
        capture: the capture.
    """
    found = capture.imported
    if found is None or found.layout != layout:
        origin = "does not record what it was imported from"
        if found is not None:
            origin = f"was imported from another layout, {found.layout}"
        return [
            f"This capture {origin}, so its cameras and frames could not be compared with those of "
            f"{_WHAT[layout]}'s evaluation."
        ]
    if layout == dynacap.LAYOUT:
        return _dynacap(capture, every)
    if found.subject not in zju.SUBJECTS:
        return [
            f"The protocol's cameras and frames are unknown for subject {found.subject!r}; only minimum "
            "numbers were checked."
        ]
    return _zju(capture, found, every)


def _zju(capture: Capture, found: Imported, every: int) -> list[str]:
    subject = zju.SUBJECTS[found.subject]
    wanted = [found.cameras[i] for i in zju.TRAIN_CAMERAS if i < len(found.cameras)]
    held_out = [name for name in found.cameras if name not in wanted]
    notes = _frames(capture, f"subject {found.subject}", len(subject.train), len(subject.novel_pose), every)
    notes += _cameras("The training cameras", capture.splits["train"].cameras, wanted)
    for name in HELD_OUT:
        notes += _cameras(f"The test cameras of {SPLITS[name]}", capture.splits[name].cameras, held_out)
    if abs(found.scale - zju.SCALE) > 1e-9:
        notes.append(
            f"Images are scaled by {found.scale:g} from {zju.SIZE[0]}² pixels; the protocol scales by "
            f"{zju.SCALE:g}."
        )
    return notes


def _dynacap(capture: Capture, every: int) -> list[str]:
    notes = _frames(capture, "a sequence", dynacap.FRAMES, dynacap.FRAMES, every)
    for name in HELD_OUT:
        cameras = len(capture.splits[name].cameras)
        if cameras != dynacap.TEST_CAMERAS:
            notes.append(f"{cameras} cameras test {SPLITS[name]}; the protocol has {dynacap.TEST_CAMERAS}.")
    return notes


def _frames(capture: Capture, whose: str, train: int, novel_pose: int, every: int) -> list[str]:
    """Notes on numbers of frames; `train` and `novel_pose` are those of the whole splits, before every n-th
    is taken.
    """
    notes = []
    have = len(capture.splits["train"].frames)
    if have != train:
        notes.append(f"Training uses {have} of the {train} training frames of {whose}.")
    for name, whole in zip(HELD_OUT, (train, novel_pose), strict=True):
        frames = len(capture.splits[name].every(every))
        wanted = len(range(0, whole, every))
        if frames != wanted:
            measured = f"{frames} frames of {SPLITS[name]} are measured"
            notes.append(f"{measured}; the protocol measures {wanted} of {whose}.")
    return notes


def _cameras(what: str, have: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """A note unless the cameras are the same, in any order."""
    if set(have) == set(wanted):
        return []
    missing = [name for name in wanted if name not in have]
    others = [name for name in have if name not in wanted]
    parts = [f"{', '.join(missing)} missing"] if missing else []
    parts += [f"{', '.join(others)} added"] if others else []
    return [f"{what} are not the protocol's: {' and '.join(parts)}."]
