"""Pictures that another program rendered, as a method: any system can be measured by the same protocols.

    FOLDER/CAMERA/000012.png   or FOLDER/CAMERA/12.png: frame 12 seen by a camera of the capture
    FOLDER/metadata.json       optional: a JSON object for the report, see `Images`

Pictures are PNG files of the camera's size, sRGB encoded, of 8 or 16 bits, in colour or grey. Where the
capture's cameras have lens distortion, pictures must be rendered without it, through `Capture.cameras`. Alpha
is straight (not premultiplied), and pictures with alpha are composited over the capture's background in
linear light.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import msgspec
import numpy as np
from PIL import Image

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.methods.base import Budget, Progress

METADATA = "metadata.json"
LISTED = 8
"""Missing pictures that a message lists; it counts the others."""


class Description(msgspec.Struct):
    """`metadata.json`: the name in tables, and keys that `ndf_mi.methods.base` lists."""

    label: str | None = None
    seconds: float | None = None
    steps: int | None = None
    converged: bool | None = None
    history: list[tuple[int, float, float]] | None = None
    note: str | None = None


class Images:
    """A folder of pictures. It renders the views that it has a picture of, and trains nothing.

    `metadata.json` may hold the members of `Description`, and others for the report. Without a label there,
    the label is the folder's name.
    """

    key, label = "images", "Images"

    def fit(self, capture: Capture, budget: Budget, progress: Progress | None = None) -> None:
        """Raises InputError: pictures are not trained."""
        raise InputError("method images", "no folder",
                         "images:FOLDER, with pictures as FOLDER/CAMERA/FRAME.png")

    def load(self, folder: str | os.PathLike[str], capture: Capture) -> None:
        """Finds the pictures of all cameras and frames of the capture's splits.

        Raises:
            InputError: there is no such folder or no picture in it, a frame has two pictures, a picture has
                the wrong size or is no PNG, or `metadata.json` is no JSON object or has an entry of the wrong
                kind.
        """
        self._folder, self._capture = Path(folder), capture
        if not self._folder.is_dir():
            raise InputError(self._folder, "no such folder", "a folder with pictures as CAMERA/FRAME.png")
        self._metadata = _read_metadata(self._folder / METADATA)
        self.label = self._metadata.pop("label", None) or self._folder.resolve().name
        views = dict.fromkeys(view for split in capture.splits.values() for view in split)
        self._files = {view: file for view in views if (file := self._find(*view)) is not None}
        if not self._files:
            raise InputError(self._folder, "no picture of any view of the capture",
                             "pictures as CAMERA/FRAME.png", f"The cameras are {', '.join(capture.cameras)}.")
        for (camera, _), file in self._files.items():
            _check_picture(file, capture.cameras[camera])

    def check_views(self, views: Sequence[tuple[str, int]]) -> None:
        """Raises InputError, listing what is missing, unless there is a picture of every (camera, frame)."""
        missing = [f"{view[0]}/{view[1]:06d}.png" for view in views if view not in self._files]
        if missing:
            more = f" and {len(missing) - LISTED} more" if len(missing) > LISTED else ""
            some = ", ".join(missing[:LISTED])
            raise InputError(self._folder, f"{len(missing)} of {len(views)} pictures missing: {some}{more}",
                             "a picture of every view that is measured")

    def render(self, camera: Camera, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] over the capture's background.

        Raises:
            InputError: there is no such picture, or it can't be decoded.
        """
        self.check_views([(camera.name, frame)])
        return _read_picture(self._files[camera.name, frame], self._capture.background)

    def metadata(self) -> dict[str, Any]:
        """The contents of `metadata.json`, the folder and the number of pictures."""
        note = f"Pictures from {self._folder}."
        return {"note": note, **self._metadata, "folder": str(self._folder), "pictures": len(self._files)}

    def cache_key(self) -> str:
        """SHA-256 (hex) over the background and the contents of all pictures."""
        state = hashlib.sha256(self._capture.background.tobytes())
        for (camera, frame), file in sorted(self._files.items()):
            state.update(f"{camera} {frame} ".encode() + hashlib.sha256(file.read_bytes()).digest())
        return state.hexdigest()

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Does nothing: the pictures stay where they are, and `load` takes that folder."""

    def _find(self, camera: str, frame: int) -> Path | None:
        names = dict.fromkeys((f"{frame:06d}.png", f"{frame}.png"))
        found = [file for name in names if (file := self._folder / camera / name).is_file()]
        if len(found) > 1:
            raise InputError(found[1], f"a second picture of frame {frame}",
                             f"one, {found[0].name} or {found[1].name}")
        return found[0] if found else None


def _read_metadata(file: Path) -> dict[str, Any]:
    if not file.exists():
        return {}
    try:
        known = msgspec.json.decode(file.read_bytes(), type=dict[str, Any])
        msgspec.convert(known, Description)
    except (OSError, msgspec.MsgspecError) as error:
        raise InputError(file, str(error),
                         'a JSON object, such as {"label": "Splats", "seconds": 600}') from None
    return known


def _check_picture(file: Path, camera: Camera) -> None:
    """Raises InputError unless the file is a PNG of the camera's size; reads its header alone."""
    try:
        with Image.open(file, formats=["PNG"]) as image:
            size = image.size
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(file, f"a file that can't be read ({error})", "a PNG") from None
    if size != (camera.w, camera.h):
        raise InputError(file, f"{size[0]} x {size[1]} pixels",
                         f"{camera.w} x {camera.h}, as camera {camera.name} has")


def _read_picture(file: Path, background: np.ndarray) -> np.ndarray:
    """(h, w, 3) float32 sRGB over a background (3,) sRGB."""
    try:
        # Pillow would cut 16-bit colours to 8 bits.
        values = np.atleast_3d(np.array(mi.Bitmap(str(file))))
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise InputError(file, f"a file that can't be decoded ({reason})", "a whole PNG") from None
    values = values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)
    alpha = values[..., -1:] if values.shape[2] in (2, 4) else None
    colour = np.repeat(values[..., :1], 3, axis=2) if values.shape[2] < 3 else values[..., :3]
    if alpha is None:
        return colour
    linear = alpha * srgb_to_linear(colour) + (1 - alpha) * srgb_to_linear(background)
    # Opaque pixels keep their exact values.
    return np.where(alpha == 1, colour, np.clip(linear_to_srgb(linear), 0, 1)).astype(np.float32)
