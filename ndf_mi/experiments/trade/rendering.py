"""Rendering a study's points in its views, and what each picture is compared with: the truth, and the same
field converged.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from skimage.transform import resize

from ndf_mi import files
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.experiments.records import View
from ndf_mi.experiments.trade.paths import CONVERGED_SPP, PathTracer
from ndf_mi.experiments.trade.points import PathSetting, Point
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import QUADRATURE
from ndf_mi.render.scene import lights
from ndf_mi.render.settings import Setting, converged, field_digest
from ndf_mi.run import Run

# Seeds of path-traced pictures; timed ones have others.
_SEED, _CONVERGED_SEED = 1, 2


class Renderings:
    """The pictures of a study.

    Args:
        capture: provides cameras and images.
        folder: where converged pictures are kept.
        views: what errors are measured on; paths are traced in the first of them alone.
        timed: how many of them are timed.
        path_size: longer side in pixels of path-traced pictures.

    Attributes:
        fields: the runs, by the names that points use.
    """

    def __init__(self, capture: Capture, folder: Path, views: list[View], timed: int, path_size: int) -> None:
        self.fields: dict[str, Run] = {}
        self._capture = capture
        self._folder = folder
        self._views = views
        # Spread over the splits: views are sorted by split.
        spread = np.linspace(0, len(views) - 1, timed).round().astype(int).tolist()
        self._timed = [views[i] for i in dict.fromkeys(spread)]
        self._path_size = path_size
        self._lights = {"sky": {"type": "constant"}} if capture.lighting is None else lights(capture.lighting)
        self._tracers: dict[str, PathTracer] = {}
        self._digests: dict[str, str] = {}

    def views(self, point: Point) -> list[View]:
        """The views that errors are measured on."""
        return self._views[:1] if point.by_paths else self._views

    def timed(self, point: Point) -> list[View]:
        """The views that are timed."""
        return self._views[:1] if point.by_paths else self._timed

    def camera(self, point: Point, view: View) -> Camera:
        """The camera of the picture: the capture's, with fewer pixels for paths."""
        camera = self._capture.cameras[view.camera]
        share = min(self._path_size / max(camera.w, camera.h), 1.0) if point.by_paths else 1.0
        if share == 1:
            return camera
        return camera.scaled(max(round(share * camera.w), 1), max(round(share * camera.h), 1))

    def draw(self, point: Point, view: View, seed: int = _SEED) -> np.ndarray:
        """(h, w, 3) float32 sRGB in [0, 1]; the seed matters to paths only."""
        return self._draw(point.field, point.setting, view.frame, self.camera(point, view), seed)

    def loading(self, point: Point) -> float | None:
        """Seconds that the scene of a frame takes to load, for paths; None for quadrature."""
        if not isinstance(point.setting, PathSetting):
            return None
        return self._tracer(point.field).loading(point.setting, self.views(point)[0].frame)

    def truth(self, point: Point, view: View) -> np.ndarray | None:
        """The capture's image at the picture's size; None if the picture shows another light.

        A field trained by quadrature holds the capture's light in its colours, so paths light it twice; one
        trained through scattering holds albedos, which quadrature does not light.
        """
        if self.scatters(self.fields[point.field]) != point.by_paths:
            return None
        camera = self.camera(point, view)
        image = self._capture.image(view.camera, view.frame)
        if image.shape[:2] == (camera.h, camera.w):
            return image
        return np.asarray(resize(image, (camera.h, camera.w), order=1, anti_aliasing=True), dtype=np.float32)

    def converged(self, point: Point, view: View) -> np.ndarray:
        """The same field with many samples; kept on disk, because it takes longer than everything else."""
        target: Setting | PathSetting = PathSetting(CONVERGED_SPP, "nested")
        if isinstance(point.setting, Setting):
            target = converged(point.setting.spp)
        camera = self.camera(point, view)
        conditions = f"{self.digest(point.field)} {target.to_dict()} {camera.w} {camera.h}"
        name = hashlib.sha256(conditions.encode()).hexdigest()[:20]
        file = self._folder / name / Path(view.file).with_suffix(".npy")
        known = _read(file, (camera.h, camera.w, 3))
        if known is not None:
            return known
        picture = self._draw(point.field, target, view.frame, camera, _CONVERGED_SEED)
        with files.replacing(file) as beside:
            np.save(beside, picture, allow_pickle=False)
        return picture

    def cache_key(self, point: Point) -> str:
        """SHA-256 (hex) over everything that the errors of a point depend on, except the code."""
        parts = [
            self.digest(point.field), self._capture.digest, point.setting.to_dict(), self.views(point),
            self._path_size * point.by_paths, converged().to_dict(), CONVERGED_SPP,
        ]
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def digest(self, name: str) -> str:
        """The digest of a field, computed once."""
        if name not in self._digests:
            self._digests[name] = field_digest(self.fields[name])
        return self._digests[name]

    @staticmethod
    def scatters(run: Run) -> bool:
        """Whether a run was trained through scattering, so that its colours are albedos."""
        return training_of(run).integrator != QUADRATURE

    def _draw(
        self, name: str, setting: Setting | PathSetting, frame: int, camera: Camera, seed: int
    ) -> np.ndarray:
        if isinstance(setting, Setting):
            return setting.picture(self.fields[name], frame, camera)
        return self._tracer(name).picture(setting, frame, camera, seed)

    def _tracer(self, name: str) -> PathTracer:
        if name not in self._tracers:
            run = self.fields[name]
            self._tracers[name] = PathTracer(run, self._lights, training_of(run).max_depth)
        return self._tracers[name]


def training_of(run: Run) -> TrainingOptions:
    """The options that a run was trained with; the defaults if they are unknown."""
    known = run.config.get("training")
    if not isinstance(known, dict):
        return TrainingOptions()
    return TrainingOptions.from_dict(known, f"{run.path / 'config.json'}: training")


def _read(file: Path, shape: tuple[int, ...]) -> np.ndarray | None:
    """A picture that was kept, or None if there is none or it does not fit."""
    try:
        picture = np.load(file, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    return picture if picture.shape == shape and picture.dtype == np.float32 else None
