"""A run's field in a performance: its image at each frame, and what decides it."""

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
    """A field that moves.

    Args:
        run: the field.
        performance: the motion, on the run's body.
        cameras: one for each frame of the performance.
        samples: candidate samples a ray.
        spp: rays a pixel.
        background: (3,) sRGB; the run's own by default.
    """

    def __init__(
        self,
        run: Run,
        performance: Performance,
        cameras: Sequence[Camera],
        *,
        samples: int = 128,
        spp: int = 1,
        background: np.ndarray | Sequence[float] | None = None,
    ) -> None:
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

    def fingerprint(self, frame: int) -> str:
        """SHA-256 of all that decides the image of a frame: the field, the pose, the shape, the camera and how it is rendered."""
        p, camera = self._performance, self._cameras[frame]
        view = [camera.w, camera.h, *(round(float(v), 6) for v in (camera.fl_x, camera.fl_y, camera.cx, camera.cy, *camera.transform.flat))]
        how = [self._renderer.samples, self._renderer.spp, [float(v) for v in self._background]]
        state = hashlib.sha256(json.dumps([ndf_mi.__version__, self._field, view, how]).encode())
        arrays = [p.motion.pose[frame], p.motion.root_rotation[frame], p.motion.translation[frame]]
        for array in (*arrays, p.shape, None if p.stored is None else p.stored[frame]):
            state.update(b"none" if array is None else np.ascontiguousarray(array, dtype=np.float32).tobytes())
        return state.hexdigest()

    def missing(self, folder: FrameFolder, frames: Sequence[int]) -> dict[int, str]:
        """Those of ``frames`` that are not in the folder as they would be rendered, with their fingerprints."""
        prints = {frame: self.fingerprint(frame) for frame in frames}
        return {frame: print_ for frame, print_ in prints.items() if not folder.has(frame, print_)}

    def write(self, folder: FrameFolder, missing: dict[int, str], progress: Callable[[], None] = lambda: None) -> None:
        """Renders the frames that `missing` found and writes each as it comes; ``progress`` is called after each."""
        for frame, print_ in missing.items():
            folder.write(frame, self.image(frame), print_)
            progress()


def boxes(performance: Performance) -> np.ndarray:
    """(T, 2, 3): the least and the largest corner of the vertices at each frame."""
    corners = []
    for frame in range(len(performance)):
        vertices = performance.vertices(frame)
        corners.append([vertices.min(0), vertices.max(0)])
    return np.array(corners)


def _field_digest(run: Run) -> str:
    """SHA-256 of the architecture, the weights and the body with the poses that it was made around."""
    state = hashlib.sha256(json.dumps(run.config["preset"], sort_keys=True).encode())
    for _, tensor in sorted(run.field_tensors().items()):
        state.update(tensor.tobytes())
    for name in ("body.npz", "poses.npz"):
        state.update((run.path / name).read_bytes())
    return state.hexdigest()
