"""Training cameras of a run as its training corrected them."""

from __future__ import annotations

import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.learn.camera_corrections import corrected
from ndf_mi.learn.refinement import CAMERAS, PREFIX
from ndf_mi.run import Run


def refined_camera(run: Run, camera: Camera) -> Camera:
    """A camera of the run's capture with its correction; unchanged if it has none."""
    row = _row(run, camera.name)
    tensors = [run.surface_tensors.get(f"{PREFIX}camera_{part}")
               for part in ("rotation", "translation", "focal")]
    if row is None or any(tensor is None for tensor in tensors):
        return camera
    rotation, translation, focal = (tensor[row] for tensor in tensors if tensor is not None)
    return corrected(camera, rotation, translation, float(focal))


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
