"""Cameras for every frame of an animation: around the performer, from a capture, or from keyframes in a JSON file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ndf_mi.animate.keyframes import interpolated, read_keyframes
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.document import FILE_NAME, read_document
from ndf_mi.capture.viewpoint import framing
from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json

_FOLLOW_SECONDS = 0.5


def orbit(
    boxes: np.ndarray, w: int, h: int, fps: float, *, turns: float = 1.0, azimuth: float = 0.0, elevation: float = 5.0
) -> list[Camera]:
    """Cameras that go round a performer and follow it, smoothly, at a distance that keeps every frame's box in the image.

    Args:
        boxes: (T, 2, 3) least and largest corner of each frame's vertices, metres.
        w, h: image size in pixels.
        fps: frames a second; the path of the box's centre is smoothed by a Gaussian of half a second.
        turns: full turns over all T frames, anticlockwise seen from above; 0 keeps the direction.
        azimuth, elevation: degrees of the first frame, as in `ndf_mi.capture.viewpoint.framing`.
    """
    boxes = boxes.astype(np.float64)
    centres = boxes.mean(1)
    sigma = _FOLLOW_SECONDS * fps
    margin = int(np.ceil(4 * sigma))
    # Continued by point reflection at both ends, so that a steady walk is followed without lag from its first frame to its last.
    longer = np.pad(centres, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    path = gaussian_filter1d(longer, sigma, axis=0)[margin : margin + len(boxes)]
    radius = (0.5 * np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1) + np.linalg.norm(centres - path, axis=1)).max()
    corner = np.full(3, radius / np.sqrt(3.0))
    angles = azimuth + 360.0 * turns * np.arange(len(boxes)) / len(boxes)
    return [framing(np.stack([c - corner, c + corner]), w, h, float(a), elevation) for c, a in zip(path, angles, strict=True)]


def read_cameras(source: str, count: int, fps: float) -> list[Camera]:
    """A camera for each of ``count`` frames, ``fps`` a second.

    Args:
        source: ``CAPTURE:NAME``, a camera of the capture in the folder CAPTURE; a ``capture.json`` that has only one; or a JSON file of
            keyframes (see `ndf_mi.animate.keyframes`).

    Raises:
        InputError: no such file or camera, or what is wrong in the file, by key.
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
        raise InputError(folder / FILE_NAME, found, f"one of {', '.join(cameras)}", f"Say which: --camera {path}:{next(iter(cameras))}")
    return cameras[name].pinhole()


def _load(path: Path) -> dict[str, Any]:
    try:
        document = load_json(path)
    except FileNotFoundError:
        raise InputError("--camera", str(path), "orbit, CAPTURE:NAME, or a JSON file of cameras") from None
    except ValueError as error:
        raise InputError(path, f"a file that cannot be read as JSON ({error})", "cameras in JSON") from None
    if not isinstance(document, dict):
        raise InputError(path, f"a {type(document).__name__}", "an object")
    return document
