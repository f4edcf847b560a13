"""A folder of rendered frames with a key for each, so that a stopped animation can continue.

    FOLDER/animation.json   the request, and a cache key for each frame
    FOLDER/000000.png       one image for each frame, 8-bit sRGB
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
        path: a folder that does not exist, is empty, or was made by this class.
        request: JSON values that describe the frames to people.

    Raises:
        InputError: the folder holds something else.
    """

    def __init__(self, path: Path, request: dict[str, Any]) -> None:
        self.path = path
        self._request = request
        self._keys = self._read()

    def frame(self, number: int) -> Path:
        """The path of a frame's image."""
        return self.path / f"{number:06d}.png"

    def has(self, number: int, key: str) -> bool:
        """Whether a frame's image is complete and was written with this key."""
        return self._keys.get(f"{number:06d}") == key and _is_complete(self.frame(number))

    def write(self, number: int, image: np.ndarray, key: str) -> None:
        """Writes a frame, (h, w, 3) sRGB in [0, 1], then its key; each atomically."""
        if self._keys.pop(f"{number:06d}", None) is not None or not (self.path / FILE_NAME).exists():
            self._save()
        write_png(self.frame(number), image)
        self._keys[f"{number:06d}"] = key
        self._save()

    def _save(self) -> None:
        document = {"format": FORMAT, "version": VERSION, "asked": self._request,
                    "frames": dict(sorted(self._keys.items()))}
        files.write_json(self.path / FILE_NAME, document)

    def _read(self) -> dict[str, str]:
        path = self.path / FILE_NAME
        repair = f"Remove {self.path}, or write to another file."
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            if self.path.is_dir() and not all(files.is_left_over(file) for file in self.path.iterdir()):
                raise InputError(self.path, f"a folder with other files and no {FILE_NAME}",
                                 "an empty or new folder for frames", repair) from None
            return {}
        except (OSError, ValueError) as error:
            raise InputError(path, f"a file that cannot be read ({error})", "JSON", repair) from None
        valid = (isinstance(document, dict) and document.get("format") == FORMAT
                 and document.get("version") == VERSION)
        if not valid or not isinstance(document.get("frames"), dict):
            raise InputError(path, "another kind of document",
                             f"a list of frames, {FORMAT!r} version {VERSION}", repair)
        return document["frames"]


def _is_complete(file: Path) -> bool:
    """Whether a PNG has all of its chunks with valid checksums; decodes nothing."""
    try:
        with Image.open(file, formats=["PNG"]) as image:
            image.verify()
    except (OSError, SyntaxError, ValueError, struct.error, Image.DecompressionBombError):
        return False
    return True
