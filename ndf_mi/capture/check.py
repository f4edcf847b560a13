"""Finds all issues of a capture, where reading it stops at the first."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.agreement import ViewAgreement, image_issue, mask_issues
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture, frame_issues
from ndf_mi.capture.document import Document, parse_document
from ndf_mi.capture.images import read_image, read_matte, undistort_matte
from ndf_mi.capture.silhouette import Silhouettes
from ndf_mi.errors import InputError

#: Largest difference, in sRGB, between the background and a pixel outside the mask: three 8-bit steps.
_BACKGROUND_TOLERANCE = 3.5 / 255

ON_MASK = 0.5
"""Least fraction of the body's vertices in an image that must fall on its mask. Fewer show that body, camera
and mask do not belong together."""


def problems(path: str | os.PathLike[str]) -> list[InputError]:
    """All issues of the capture in the folder ``path``, each with its file and key.

    Besides what the reader refuses, these are images whose background is not the declared one, and bodies,
    masks and images that do not belong together (``ndf_mi.capture.agreement``), which show a wrong unit, axis
    or frame number. Needs a Mitsuba variant.
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
        found += frame_issues(folder, document, poses)
    drawn = None if body is None or poses is None else Silhouettes(body.faces, poses.vertices.shape[1])
    views: list[ViewAgreement] = []
    for camera, frame in document.images():
        found += _image_issues(folder, document, poses, camera, frame, drawn, views)
    return found + mask_issues(views, folder)


def summary(capture: Capture) -> str:
    """Describes the contents of a capture in a few lines."""
    sizes = sorted({(camera.w, camera.h) for camera in capture.cameras.values()})
    pixels = ", ".join(f"{w} x {h}" for w, h in sizes)
    lines = [
        f"{capture.name}: {len(capture.cameras)} cameras of {pixels} pixels",
        f"body: {capture.poses.vertices.shape[1]} vertices, {len(capture.body.faces)} triangles, "
        f"{len(capture.poses.frames)} posed frames",
    ]
    for name, split in capture.splits.items():
        if name == "sequence" and not len(split):
            continue
        cameras, frames = len(split.cameras), len(split.frames)
        lines.append(f"{name}: {cameras} cameras x {frames} frames = {len(split)} images")
    lines.append(f"digest: {capture.digest}")
    return "\n".join(lines)


def _image_issues(
    folder: Path, document: Document, poses: Poses | None, camera_name: str, frame: int,
    silhouettes: Silhouettes | None, views: list[ViewAgreement],
) -> list[InputError]:
    """The issues of one image. Appends to `views` how body and mask agree, if both are there."""
    camera = document.cameras[camera_name]
    found: list[InputError] = []

    def attempt(read: Callable[[Path, tuple[int, int]], np.ndarray], file: Path) -> np.ndarray | None:
        try:
            return read(file, (camera.w, camera.h))
        except InputError as error:
            found.append(error)
            return None

    image_file, mask_file = document.files(folder, camera_name, frame)
    image, matte = attempt(read_image, image_file), attempt(read_matte, mask_file)
    mask = None if matte is None else matte >= 0.5
    if image is not None and matte is not None and not matte.all():
        difference = float(np.abs(image[matte == 0] - np.array(document.background, dtype=np.float32)).max())
        if difference > _BACKGROUND_TOLERANCE:
            declared = f"{list(document.background)}, within {_BACKGROUND_TOLERANCE:.3f}"
            differing = f"pixels outside the mask that differ from the background by up to {difference:.3f}"
            found.append(InputError(image_file, differing, f"the background in capture.json, {declared}"))
    view = None
    if mask is not None and silhouettes is not None and poses is not None and frame in poses.frames:
        vertices = poses.vertices[poses.index(frame)]
        silhouettes.pose(vertices)
        view = ViewAgreement.of(mask_file, f"camera {camera_name}, frame {frame}", undistorted(mask, camera),
                                silhouettes.draw(camera.pinhole()))
        share = fraction_on_mask(camera, vertices, mask)
        if view.issue is not None or share >= ON_MASK:
            views.append(view)
        else:
            found.append(InputError(
                mask_file,
                f"only {share:.0%} of the body's vertices in camera {camera_name} on the mask",
                f"{ON_MASK:.0%} or more",
                "Check units (metres), the camera's axes (OpenGL) and the frame's number in poses.npz.",
            ))
    # Where the mask is wrong by itself, the image cannot match it.
    if image is not None and mask is not None and (view is None or view.issue is None):
        issue = image_issue(image_file, image, mask, np.array(document.background, dtype=np.float32))
        found += [] if issue is None else [issue]
    return found


def undistorted(mask: np.ndarray, camera: Camera) -> np.ndarray:
    """(h, w) bool as seen by ``camera.pinhole()``."""
    return mask if camera.is_pinhole else undistort_matte(mask.astype(np.float32), camera) > 0


def fraction_on_mask(camera: Camera, vertices: np.ndarray, mask: np.ndarray) -> float:
    """The fraction of a body's vertices, (V, 3), in the image that are on or next to the mask, (h, w) bool;
    0 for none."""
    pixels = camera.project(vertices)
    height, width = mask.shape
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    columns, rows = np.floor(pixels[inside]).astype(int).T
    # A vertex on the outline may fall into the pixel next to it.
    return float(binary_dilation(mask)[rows, columns].mean()) if inside.any() else 0.0
