"""Finds everything that is wrong with a capture's folder, where the reader stops at the first."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture, frame_faults
from ndf_mi.capture.document import Document, parse_document
from ndf_mi.capture.images import read_image, read_mask
from ndf_mi.errors import InputError

#: Largest difference, in sRGB, of a pixel outside the mask from the background: three steps of 8 bits.
_BACKGROUND_TOLERANCE = 3.5 / 255

#: Least share of the body's vertices, those in front of the camera, that fall on the mask when body and camera fit.
_ON_MASK = 0.5


def problems(path: str | os.PathLike[str]) -> list[InputError]:
    """Everything wrong with the capture in the folder ``path``, each with its file, key, what was found and expected.

    Besides what the reader refuses, it finds images whose background isn't the one declared and bodies that lie off
    their mask, which is how a wrong unit, axis or frame number shows.
    """
    folder = Path(path)
    document, found = parse_document(folder)
    if not folder.is_dir():
        return found
    body: Body | None = None
    poses: Poses | None = None
    try:
        body = Body.read(folder / "body.npz")
        poses = Poses.read(folder / "poses.npz", body)
    except InputError as error:
        found.append(error)
    if document is None:
        return found
    if poses is not None:
        found += frame_faults(folder, document, poses)
    for camera, frame in document.images():
        found += _image_problems(folder, document, poses, camera, frame)
    return found


def summary(capture: Capture) -> str:
    """Some lines that say what the capture holds."""
    sizes = sorted({(camera.w, camera.h) for camera in capture.cameras.values()})
    lines = [
        f"{capture.name}: {len(capture.cameras)} cameras of {', '.join(f'{w} x {h}' for w, h in sizes)} pixels",
        f"body: {capture.poses.vertices.shape[1]} vertices, {len(capture.body.faces)} triangles, "
        f"{len(capture.poses.frames)} posed frames",
    ]
    for name, split in capture.splits.items():
        if name == "sequence" and not len(split):
            continue
        lines.append(f"{name}: {len(split.cameras)} cameras x {len(split.frames)} frames = {len(split)} images")
    lines.append(f"digest: {capture.digest}")
    return "\n".join(lines)


def _image_problems(
    folder: Path, document: Document, poses: Poses | None, camera_name: str, frame: int
) -> list[InputError]:
    camera = document.cameras[camera_name]
    found: list[InputError] = []
    image: np.ndarray | None = None
    mask: np.ndarray | None = None
    image_file = folder / document.image_pattern.format(camera=camera_name, frame=frame)
    mask_file = folder / document.mask_pattern.format(camera=camera_name, frame=frame)
    try:
        image = read_image(image_file, (camera.w, camera.h))
    except InputError as error:
        found.append(error)
    try:
        mask = read_mask(mask_file, (camera.w, camera.h))
    except InputError as error:
        found.append(error)
    if image is not None and mask is not None and not mask.all():
        difference = float(np.abs(image[~mask] - np.array(document.background, dtype=np.float32)).max())
        if difference > _BACKGROUND_TOLERANCE:
            found.append(
                InputError(
                    image_file,
                    f"pixels outside the mask that differ from the background by up to {difference:.3f}",
                    f"the background of capture.json, {list(document.background)}, within {_BACKGROUND_TOLERANCE:.3f}",
                )
            )
    if mask is not None and poses is not None and frame in poses.frames:
        # A vertex on the outline may fall into the pixel beside it.
        share = _share_on_mask(camera.project(poses.vertices[poses.index(frame)]), binary_dilation(mask))
        if share < _ON_MASK:
            found.append(
                InputError(
                    mask_file,
                    f"only {share:.0%} of the body's vertices seen from camera {camera_name} on the mask",
                    f"{_ON_MASK:.0%} or more",
                    "look at the units (metres), the camera's axes (OpenGL) and the frame's number in poses.npz",
                )
            )
    return found


def _share_on_mask(pixels: np.ndarray, mask: np.ndarray) -> float:
    """Share of projected points, those within the image, that fall on the mask; 0 when none is within it."""
    height, width = mask.shape
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    columns, rows = np.floor(pixels[inside]).astype(int).T
    return float(mask[rows, columns].mean()) if inside.any() else 0.0
