"""Frames to an MP4 that players everywhere show: H.264, 4:2:0, even sizes, colours tagged as BT.709."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.optional import require

_CODEC = ["-crf", "16", "-preset", "slow", "-movflags", "+faststart", "-vf", "scale=out_color_matrix=bt709:out_range=tv",
          "-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1", "-color_range", "tv"]  # fmt: skip


def check_suffix(path: str | os.PathLike[str]) -> None:
    """Raises InputError unless a video can be written to the path: its name ends in .mp4, it is no folder, and the extra ``video`` is
    installed."""
    if Path(path).suffix.lower() != ".mp4":
        raise InputError(path, f"the ending {Path(path).suffix!r}", ".mp4")
    if Path(path).is_dir():
        raise InputError(path, "a folder of that name", "a file's name")
    require("imageio_ffmpeg", extra="video")


def write_video(
    path: str | os.PathLike[str], frames: Iterable[Path], fps: float, progress: Callable[[], None] = lambda: None
) -> None:
    """Writes images, 8-bit RGB of one size, as a video of ``fps`` frames a second; whole or not at all. An odd width or height gains a
    repeated column on the right or row at the bottom. ``progress`` is called after each frame."""
    imageio = require("imageio.v2", extra="video")
    with files.replacing(path) as beside:
        writer = imageio.get_writer(
            beside, format="FFMPEG", fps=fps, codec="libx264", pixelformat="yuv420p", macro_block_size=1,
            ffmpeg_log_level="error", output_params=_CODEC,
        )  # fmt: skip
        with writer:
            for frame in frames:
                image = imageio.imread(frame)
                h, w = image.shape[:2]
                writer.append_data(np.pad(image, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge"))
                progress()
