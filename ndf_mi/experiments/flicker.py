"""Temporal consistency: does the picture change from frame to frame as the truth does?

For successive frames t, t+1 of one camera, images I, truth G (sRGB in [0, 1]) and the pixels B of each
frame's box, tPSNR_t in dB is −10·log10 of the mean of ((I_{t+1} − I_t) − (G_{t+1} − G_t))² over B_t ∪ B_{t+1}
and channels. Rounding to 8 bits limits it to about 56 dB. docs/protocols.md has its properties.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Split
from ndf_mi.experiments import metrics
from ndf_mi.experiments.records import Flicker, FrameSequence, View


def choose_sequences(capture: Capture, count: int) -> list[FrameSequence]:
    """Up to `count` successive frames of the split `sequence`, in its first camera; without such a split, of
    each split.

    Of all series of so many successive frames, the first of those whose frames are closest together is taken.
    Splits with fewer than two frames have no sequence; a `count` of 0 selects none.
    """
    chosen = []
    own = capture.splits.get("sequence", Split())
    splits = {"sequence": own} if len(own.frames) > 1 else capture.splits
    for name, split in splits.items():
        length = min(count, len(split.frames))
        if length > 1 and split.cameras:
            frames = sorted(split.frames)
            runs = (tuple(frames[i : i + length]) for i in range(len(frames) - length + 1))
            closest = min(runs, key=lambda run: run[-1] - run[0])
            chosen.append(FrameSequence(name, split.cameras[0], closest))
    return chosen


def measure_flicker(capture: Capture, sequence: FrameSequence, pictures: Path) -> Flicker:
    """Measures one method's pictures of a sequence.

    Args:
        capture: the truth.
        sequence: the frames.
        pictures: the method's folder of 8-bit pictures, which must hold all of them.
    """
    camera = capture.cameras[sequence.camera]
    flicker = Flicker(sequence, [], [])
    before: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    for view in sequence.views:
        mask = metrics.box_mask(camera, capture.poses.vertices[capture.poses.index(view.frame)])
        after = capture.image(view.camera, view.frame), read_picture(pictures, view), mask
        if before is not None:
            flicker.tpsnr.append(_change(before, after))
            flicker.frozen.append(_change(before, (after[0], before[1], mask)))
        before = after
    return flicker


def read_picture(pictures: Path, view: View) -> np.ndarray:
    """A method's 8-bit picture of a view, (h, w, 3) float32 sRGB in [0, 1]."""
    with Image.open(pictures / view.file) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.float32) / 255


def _change(
    before: tuple[np.ndarray, np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> float | None:
    """Temporal PSNR of (truth, picture, box mask) of two frames; None if both boxes are out of sight."""
    mask = before[2] | after[2]
    return metrics.temporal_psnr((before[0], after[0]), (before[1], after[1]), mask) if mask.any() else None
