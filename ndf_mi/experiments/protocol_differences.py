"""Where an imported capture differs from what the publications took of its subject: sentences for a protocol's notes."""

from __future__ import annotations

from collections.abc import Sequence

from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Imported
from ndf_mi.capture.readers import dynacap, zju

_WHAT = {zju.LAYOUT: "ZJU-MoCap", dynacap.LAYOUT: "DynaCap"}


def differences(layout: str, every: int, capture: Capture) -> list[str]:
    """What of a capture is other than in the publications' evaluation on its subject; empty where nothing is.

    Of frames it is compared how many they are: a selection begins with the first of a split, so that as many of every so-and-so-many-th
    are the same ones. So it is with DynaCap's cameras, of which the publication doesn't say more; nor does it say the images' size.

    Args:
        layout: `zju.LAYOUT` or `dynacap.LAYOUT`.
        every: of a held-out split every how many-th frame is measured.
        capture: the capture.
    """
    found = capture.imported
    if found is None or found.layout != layout:
        origin = "does not say what it was imported from" if found is None else f"was imported from another layout, {found.layout}"
        return [f"This capture {origin}: whether its cameras and frames are those of {_WHAT[layout]}'s evaluation is not known."]
    if layout == dynacap.LAYOUT:
        return _dynacap(capture, every)
    if found.subject not in zju.SUBJECTS:
        return [f"Of subject {found.subject!r} the protocol is not known: only the least numbers of cameras and frames are checked."]
    return _zju(capture, found, every)


def _zju(capture: Capture, found: Imported, every: int) -> list[str]:
    subject = zju.SUBJECTS[found.subject]
    wanted = [found.cameras[i] for i in zju.TRAIN_CAMERAS if i < len(found.cameras)]
    held_out = [name for name in found.cameras if name not in wanted]
    notes = _frames(capture, f"subject {found.subject}", len(subject.train), len(subject.novel_pose), every)
    notes += _cameras("Training cameras are", capture.splits["train"].cameras, wanted)
    for name, label in (("novel_view", "novel views"), ("novel_pose", "novel poses")):
        notes += _cameras(f"Test cameras of {label} are", capture.splits[name].cameras, held_out)
    if abs(found.scale - zju.SCALE) > 1e-9:
        notes.append(f"Images are at {found.scale:g} of {zju.SIZE[0]}² pixels; the protocol's are at {zju.SCALE:g}.")
    return notes


def _dynacap(capture: Capture, every: int) -> list[str]:
    notes = _frames(capture, "a sequence", dynacap.FRAMES, dynacap.FRAMES, every)
    counts = {"novel_view": "novel views", "novel_pose": "novel poses"}
    for name, label in counts.items():
        cameras = len(capture.splits[name].cameras)
        if cameras != dynacap.TEST_CAMERAS:
            notes.append(f"{cameras} cameras test {label}; the protocol has {dynacap.TEST_CAMERAS}.")
    return notes


def _frames(capture: Capture, whose: str, train: int, novel_pose: int, every: int) -> list[str]:
    """Notes on numbers of frames: `train` and `novel_pose` are those of the whole splits, every `every`-th of which is measured."""
    notes = []
    have = len(capture.splits["train"].frames)
    if have != train:
        notes.append(f"{have} of {train} training frames of {whose} are trained on.")
    for name, label, whole in (("novel_view", "novel views", train), ("novel_pose", "novel poses", novel_pose)):
        frames = capture.splits[name].every(every)
        wanted = len(range(0, whole, every))
        if len(frames) != wanted:
            notes.append(f"{len(frames)} frames of {label} are measured; the protocol has {wanted} of {whose}.")
    return notes


def _cameras(what: str, have: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """A note unless the cameras are the same, in whatever order."""
    if set(have) == set(wanted):
        return []
    missing = [name for name in wanted if name not in have]
    others = [name for name in have if name not in wanted]
    parts = [f"without {', '.join(missing)}"] if missing else []
    parts += [f"with {', '.join(others)}"] if others else []
    return [f"{what} not the protocol's, but {' and '.join(parts)}."]
