"""Frame folders: complete frames are kept, and nothing is written among other files."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ndf_mi import files
from ndf_mi.animate.frames import FrameFolder
from ndf_mi.errors import InputError


@pytest.mark.parametrize("keep", [0, 4, 20, 0.5, 0.99, -13])
def test_a_frame_that_cannot_be_read_is_missing(tmp_path: Path, keep: float) -> None:
    folder = FrameFolder(tmp_path / "a", {})
    image = np.random.default_rng(0).random((40, 40, 3))
    for number in (0, 1):
        folder.write(number, image, "print")
    assert folder.has(0, "print") and folder.has(1, "print")
    whole = folder.frame(1).read_bytes()
    folder.frame(1).write_bytes(whole[: int(keep * len(whole)) if 0 < keep < 1 else int(keep)])
    assert folder.has(0, "print") and not folder.has(1, "print")
    folder.frame(1).write_bytes(whole[:200] + bytes(20) + whole[220:])
    assert not folder.has(1, "print")


def test_leftovers_of_a_killed_write_are_ignored(tmp_path: Path) -> None:
    """Killed while the first animation.json is written: only what would be renamed to it is there."""
    place = tmp_path / "a"
    killed = "import os, pathlib\nfrom ndf_mi import files\n"
    target = str(place / "animation.json")
    killed += f"with files.replacing(pathlib.Path({target!r})) as beside:\n    os._exit(9)\n"
    assert subprocess.run([sys.executable, "-c", killed], check=False).returncode == 9
    (left,) = place.iterdir()
    assert left.suffix == ".json" and files.is_left_over(left)
    assert not files.is_left_over(place / "animation.json")
    FrameFolder(place, {}).write(0, np.zeros((2, 2, 3)), "print")
    assert FrameFolder(place, {}).has(0, "print")


def test_folders_with_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("")
    with pytest.raises(InputError, match="animation.json"):
        FrameFolder(tmp_path, {})
    for text, message in (("{", "animation.json"), ('{"format": "other"}', "ndf-animation")):
        (tmp_path / "animation.json").write_text(text)
        with pytest.raises(InputError, match=message):
            FrameFolder(tmp_path, {})


def test_the_request_and_the_keys_are_on_disk(tmp_path: Path) -> None:
    folder = FrameFolder(tmp_path / "a", {"motion": "walk"})
    folder.write(7, np.zeros((2, 2, 3)), "abc")
    found = json.loads((tmp_path / "a" / "animation.json").read_text())
    assert found["asked"] == {"motion": "walk"} and found["frames"] == {"000007": "abc"}
