"""A folder of rendered frames that remembers what each of them shows, so that a stopped animation goes on where it was.

    FOLDER/animation.json   what was asked for, and a fingerprint a frame
    FOLDER/000000.png       one image a frame, 8-bit sRGB
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ndf_mi import files
from ndf_mi.errors import InputError
from ndf_mi.render.output import write_png

FORMAT = "ndf-animation"
VERSION = 1
FILE_NAME = "animation.json"


class FrameFolder:
    """Frames on disk. Nothing is written before the first frame.

    Args:
        path: the folder: none yet, an empty one, or one that was made by this class.
        asked: JSON values for people: what the frames were made with.

    Raises:
        InputError: the folder holds something else.
    """

    def __init__(self, path: Path, asked: dict[str, Any]) -> None:
        self.path = path
        self._asked = asked
        self._fingerprints = self._read()

    def frame(self, number: int) -> Path:
        """Where the image of a frame is or would be."""
        return self.path / f"{number:06d}.png"

    def has(self, number: int, fingerprint: str) -> bool:
        """Whether the frame is there, whole, and shows what ``fingerprint`` stands for."""
        return self._fingerprints.get(f"{number:06d}") == fingerprint and _is_whole(self.frame(number))

    def write(self, number: int, image: np.ndarray, fingerprint: str) -> None:
        """Writes a frame, (h, w, 3) sRGB in [0, 1], and then what it shows; each whole or not at all."""
        if self._fingerprints.pop(f"{number:06d}", None) is not None or not (self.path / FILE_NAME).exists():
            self._save()
        write_png(self.frame(number), image)
        self._fingerprints[f"{number:06d}"] = fingerprint
        self._save()

    def _save(self) -> None:
        ordered = dict(sorted(self._fingerprints.items()))
        files.write_json(self.path / FILE_NAME, {"format": FORMAT, "version": VERSION, "asked": self._asked, "frames": ordered})

    def _read(self) -> dict[str, str]:
        path = self.path / FILE_NAME
        repair = f"Remove {self.path}, or write to another file."
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            if self.path.is_dir() and not all(files.is_left_over(file) for file in self.path.iterdir()):
                raise InputError(self.path, f"a folder with other files and no {FILE_NAME}", "an empty place for frames", repair) from None
            return {}
        except (OSError, ValueError) as error:
            raise InputError(path, f"a file that cannot be read ({error})", "JSON", repair) from None
        right = isinstance(document, dict) and document.get("format") == FORMAT and document.get("version") == VERSION
        if not right or not isinstance(document.get("frames"), dict):
            raise InputError(path, "something else", f"the description of frames, {FORMAT!r} version {VERSION}", repair)
        return document["frames"]


def _is_whole(file: Path) -> bool:
    """Whether there is a PNG with all of its chunks and their checksums; nothing is decoded."""
    try:
        with Image.open(file, formats=["PNG"]) as image:
            image.verify()
    except (OSError, SyntaxError, ValueError, struct.error, Image.DecompressionBombError):
        return False
    return True
