"""A camera for each frame of an animation: an orbit around the performer, a capture's camera, or keyframes in
JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ndf_mi.animate.keyframes import interpolated, read_keyframes
from ndf_mi.capture.camera import Camera, framing
from ndf_mi.capture.document import FILE_NAME, read_document
from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json

_FOLLOW_SECONDS = 0.5


def orbit(boxes: np.ndarray, w: int, h: int, fps: float, *, turns: float = 1.0, azimuth: float = 0.0,
          elevation: float = 5.0) -> list[Camera]:
    """Cameras that circle a performer and follow it smoothly, at a distance that keeps every frame's box in
    the image.

    Args:
        boxes: (T, 2, 3) lower and upper corner of each frame's vertices, metres.
        w, h: image size in pixels.
        fps: frames a second; a Gaussian of half a second smooths the path of the box's centre.
        turns: full turns over all T frames, anticlockwise seen from above; 0 keeps the direction.
        azimuth, elevation: degrees at the first frame, as in `ndf_mi.capture.camera.framing`.
    """
    boxes = boxes.astype(np.float64)
    centres = boxes.mean(1)
    sigma = _FOLLOW_SECONDS * fps
    margin = int(np.ceil(4 * sigma))
    # Point reflection at both ends, so that the camera follows a steady walk without lag from the first frame
    # to the last.
    padded = np.pad(centres, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    path = gaussian_filter1d(padded, sigma, axis=0)[margin : margin + len(boxes)]
    halves, aside = (np.linalg.norm(v, axis=1) for v in (0.5 * (boxes[:, 1] - boxes[:, 0]), centres - path))
    radius = (halves + aside).max()
    corner = np.full(3, radius / np.sqrt(3.0))
    angles = azimuth + 360.0 * turns * np.arange(len(boxes)) / len(boxes)
    return [framing(np.stack([c - corner, c + corner]), w, h, float(a), elevation)
            for c, a in zip(path, angles, strict=True)]


def read_cameras(source: str, count: int, fps: float) -> list[Camera]:
    """A camera for each of ``count`` frames, ``fps`` a second.

    Args:
        source: ``CAPTURE:NAME`` for a camera of the capture in the folder CAPTURE; CAPTURE or its
            ``capture.json`` if the capture has one camera; or a JSON file of keyframes (see
            `ndf_mi.animate.keyframes`).

    Raises:
        InputError: there is no such file or camera, or an entry of the file is wrong.
    """
    path = Path(source)
    if not path.exists() and ":" in source:
        folder, _, name = source.rpartition(":")
        return [_captured(Path(folder), name)] * count
    if path.is_dir():
        return [_captured(path, None)] * count
    document = _load(path)
    if document.get("format") == "ndf-capture":
        return [_captured(path, None)] * count
    return interpolated(read_keyframes(document, path), count, fps)


def _captured(path: Path, name: str | None) -> Camera:
    folder = path.parent if path.name == FILE_NAME else path
    cameras = read_document(folder).cameras
    if name is None and len(cameras) == 1:
        return next(iter(cameras.values())).pinhole()
    if name not in cameras:
        found = f"{len(cameras)} cameras" if name is None else f"no camera {name}"
        raise InputError(folder / FILE_NAME, found, f"one of {', '.join(cameras)}",
                         f"Name it, for example: --camera {path}:{next(iter(cameras))}")
    return cameras[name].pinhole()


def _load(path: Path) -> dict[str, Any]:
    if not path.exists():
        raise InputError("--camera", str(path), "orbit, CAPTURE:NAME, or a JSON file of cameras")
    document = load_json(path, "cameras in JSON")
    if not isinstance(document, dict):
        raise InputError(path, f"a {type(document).__name__}", "an object")
    return document
