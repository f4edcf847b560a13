"""Training cameras as the outlines of masks and the training corrected them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.learn.camera_corrections import corrected
from ndf_mi.learn.refinement import CAMERAS, PREFIX
from ndf_mi.learn.registration import PREFIX as REGISTERED
from ndf_mi.run import Run


def refined_camera(run: Run, camera: Camera) -> Camera:
    """A camera of the run's capture with its corrections; unchanged if it has none."""
    row = _row(run, camera.name)
    if row is None:
        return camera
    registered = _corrected(camera, run.surface_tensors, REGISTERED, row)
    return _corrected(registered, run.surface_tensors, PREFIX, row)


def registered_capture(capture: Capture, tensors: Mapping[str, np.ndarray]) -> Capture:
    """The capture with its training cameras as registration corrected them.

    Args:
        capture: as read from disk.
        tensors: as `Run.surface_tensors`.
    """
    return capture.with_cameras([_corrected(capture.cameras[name], tensors, REGISTERED, row)
                                 for row, name in enumerate(capture.splits["train"].cameras)])


def seen_by(run: Run, camera: Camera, linear: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """The premultiplied linear colours that a camera of the run's capture sees.

    Args:
        linear: (h, w, 3) premultiplied, as the field has them.
        opacity: (h, w).

    Returns:
        (h, w, 3): A L + b·opacity with the camera's map of colour; unchanged if it has none.
    """
    row = _row(run, camera.name)
    matrix, offset = (run.surface_tensors.get(f"{PREFIX}colour_{part}") for part in ("matrix", "offset"))
    if row is None or matrix is None or offset is None:
        return linear
    return linear @ matrix[row].T + opacity[..., None] * offset[row]


def _row(run: Run, name: str) -> int | None:
    names = run.config.get(CAMERAS)
    return names.index(name) if isinstance(names, list) and name in names else None


def _corrected(camera: Camera, tensors: Mapping[str, np.ndarray], prefix: str, row: int) -> Camera:
    """A camera with the corrections in one row of the tensors that begin with `prefix`, if there are any."""
    rotation, translation, focal = (tensors.get(f"{prefix}camera_{part}")
                                    for part in ("rotation", "translation", "focal"))
    if rotation is None or translation is None or focal is None:
        return camera
    return corrected(camera, rotation[row], translation[row], float(focal[row]))
