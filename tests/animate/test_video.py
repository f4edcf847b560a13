"""Videos read back with the frames that were written."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from skimage.io import imsave

from ndf_mi.animate.video import check_suffix, write_video
from ndf_mi.errors import InputError


def test_video_reads_back(tmp_path: Path) -> None:
    """Five frames of one colour each, of odd sizes: as many come back, padded to even sizes, in their
    colours."""
    colours = [(200, 40, 40), (30, 160, 60), (40, 60, 210), (128, 128, 128), (240, 230, 90)]
    paths = []
    for i, colour in enumerate(colours):
        paths.append(tmp_path / f"{i}.png")
        imsave(paths[-1], np.full((45, 63, 3), colour, np.uint8), check_contrast=False)
    seen = []
    write_video(tmp_path / "v.mp4", paths, 12.5, lambda: seen.append(1))
    with imageio.get_reader(tmp_path / "v.mp4") as video:
        facts, back = video.get_meta_data(), [np.asarray(frame) for frame in video]
    assert len(back) == len(seen) == 5 and facts["size"] == (64, 46) and facts["fps"] == 12.5
    assert facts["codec"] == "h264" and facts["pix_fmt"].startswith("yuv420p")
    for frame, colour in zip(back, colours, strict=True):
        assert np.abs(frame.astype(int) - colour).max() <= 4
    with pytest.raises(InputError, match=".mp4"):
        check_suffix("v.avi")
    with pytest.raises(FileNotFoundError):
        write_video(tmp_path / "w.mp4", [tmp_path / "none.png"], 10)
    assert not list(tmp_path.glob("*w*.mp4"))
