"""The images of a field in a performance, and a key that changes with anything that changes an image."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence

import numpy as np

import ndf_mi
from ndf_mi.animate.frames import FrameFolder
from ndf_mi.body.motion_file import Performance
from ndf_mi.capture.camera import Camera
from ndf_mi.render.image import ImageRenderer
from ndf_mi.run import Run


class Animation:
    """A field in motion.

    Args:
        run: the field.
        performance: the motion, on the run's body.
        cameras: one for each frame of the performance.
        samples: candidate samples a ray.
        spp: rays a pixel.
        background: (3,) sRGB; the run's own by default.
    """

    def __init__(self, run: Run, performance: Performance, cameras: Sequence[Camera], *, samples: int = 128,
                 spp: int = 1, background: np.ndarray | Sequence[float] | None = None) -> None:
        self._run = run
        self._performance = performance
        self._cameras = cameras
        self._background = run.background if background is None else np.asarray(background, dtype=np.float32)
        self._renderer = ImageRenderer(samples, spp=spp)
        self._field = _field_digest(run)

    def image(self, frame: int) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1] of one frame of the performance."""
        posed = self._run.posed_as(self._performance.vertices(frame), self._performance.motion.pose[frame])
        return self._renderer(posed, self._cameras[frame]).over(self._background)

    def cache_key(self, frame: int) -> str:
        """SHA-256 of all that a frame's image depends on: field, pose, shape, camera, settings."""
        p, camera = self._performance, self._cameras[frame]
        intrinsics = (camera.fl_x, camera.fl_y, camera.cx, camera.cy, *camera.transform.flat)
        view = [camera.w, camera.h, *(round(float(v), 6) for v in intrinsics)]
        settings = [self._renderer.samples, self._renderer.spp, [float(v) for v in self._background]]
        digest = hashlib.sha256(json.dumps([ndf_mi.__version__, self._field, view, settings]).encode())
        arrays = [p.motion.pose[frame], p.motion.root_rotation[frame], p.motion.translation[frame]]
        for array in (*arrays, p.shape, None if p.stored is None else p.stored[frame]):
            digest.update(b"none" if array is None
                          else np.ascontiguousarray(array, dtype=np.float32).tobytes())
        return digest.hexdigest()

    def missing(self, folder: FrameFolder, frames: Sequence[int]) -> dict[int, str]:
        """The frames that the folder lacks or has with another key, with their keys."""
        keys = {frame: self.cache_key(frame) for frame in frames}
        return {frame: key for frame, key in keys.items() if not folder.has(frame, key)}

    def write(self, folder: FrameFolder, missing: dict[int, str],
              progress: Callable[[], None] = lambda: None) -> None:
        """Renders and writes the frames that :meth:`missing` returned, one by one; calls `progress` after
        each."""
        for frame, key in missing.items():
            folder.write(frame, self.image(frame), key)
            progress()


def boxes(performance: Performance) -> np.ndarray:
    """(T, 2, 3) lower and upper corners of the vertices at each frame."""
    corners = []
    for frame in range(len(performance)):
        vertices = performance.vertices(frame)
        corners.append([vertices.min(0), vertices.max(0)])
    return np.array(corners)


def _field_digest(run: Run) -> str:
    """SHA-256 of the architecture, the parameters, and the body, poses and bands that they were trained
    with."""
    digest = hashlib.sha256(json.dumps(run.config["preset"], sort_keys=True).encode())
    for _, tensor in sorted(run.tensors().items()):
        digest.update(tensor.tobytes())
    for name in ("body.npz", "poses.npz"):
        digest.update((run.path / name).read_bytes())
    return digest.hexdigest()
