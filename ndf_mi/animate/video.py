"""Encodes frames as an MP4 that plays everywhere: H.264, 4:2:0, even sizes, BT.709 colours."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.optional import require

_CODEC = ["-crf", "16", "-preset", "slow", "-movflags", "+faststart", "-vf",
          "scale=out_color_matrix=bt709:out_range=tv", "-colorspace", "bt709", "-color_primaries", "bt709",
          "-color_trc", "iec61966-2-1", "-color_range", "tv"]


def check_suffix(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless a video can be written: the name ends in .mp4, the path is no folder, and the
    extra ``video`` is installed."""
    if Path(path).suffix.lower() != ".mp4":
        raise InputError(path, f"the ending {Path(path).suffix!r}", ".mp4")
    if Path(path).is_dir():
        raise InputError(path, "a folder of that name", "a file name")
    require("imageio_ffmpeg", extra="video")


def write_video(path: str | os.PathLike[str], frames: Iterable[Path], fps: float,
                progress: Callable[[], None] = lambda: None) -> None:
    """Writes images as a video, atomically.

    Args:
        path: the video.
        frames: 8-bit RGB images of one size. The last column or row is repeated if the width or height is
            odd.
        fps: frames a second.
        progress: called after each frame.
    """
    imageio = require("imageio.v2", extra="video")
    with files.replacing(path) as beside:
        writer = imageio.get_writer(beside, format="FFMPEG", fps=fps, codec="libx264", pixelformat="yuv420p",
                                    macro_block_size=1, ffmpeg_log_level="error", output_params=_CODEC)
        with writer:
            for frame in frames:
                image = imageio.imread(frame)
                h, w = image.shape[:2]
                writer.append_data(np.pad(image, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge"))
                progress()
