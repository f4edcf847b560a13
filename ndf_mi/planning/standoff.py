"""How far what is seen stands off the body: rays where mask and body disagree, and how close to the body's surface they come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.planning.observations import View
from ndf_mi.projection import PosedSurface, Surface

#: Metres from the body that are looked at; what stands off further counts as this.
REACH = 0.25
#: Points along a ray that distances are taken at: a centimetre or two apart, which errs by a millimetre where the distance is a centimetre.
_POINTS = 160
#: Rays looked along at a time.
_RAYS = 1 << 16


@dataclass(frozen=True)
class Disagreement:
    """Pixels of one kind: distances (K,) in metres, 0 or more, and what it costs (K,) to leave each out, as squared error in sRGB."""

    distance: np.ndarray
    cost: np.ndarray

    def reach(self, allowed: float) -> float:
        """The least distance beyond which all pixels together cost no more than `allowed`; metres."""
        order = np.argsort(-self.distance)
        beyond = np.cumsum(self.cost[order]) > allowed
        return float(self.distance[order][beyond.argmax()]) if beyond.any() else 0.0


@dataclass(frozen=True)
class Standoff:
    """Where the masks hold more than the body's silhouette, and where less.

    Attributes:
        outside: pixels of the mask beside the body, by how close to the body their rays come: what is seen there is at least so far off it.
        inside: pixels of the body beside the mask, by how deep in the body their rays pass: what is seen elsewhere lies at least so deep.
        pixels: how many pixels the masks have in all.
    """

    outside: Disagreement
    inside: Disagreement
    pixels: int


def standoff(capture: Capture, frames: Sequence[int], views: Sequence[View]) -> Standoff:
    """Of the training images of `frames` that `views` are."""
    surface = Surface(capture.body.faces, capture.body.uv, capture.body.uv_faces, capture.poses.vertices[0])
    cameras = [capture.cameras[name] for name in capture.splits["train"].cameras]
    parts: dict[bool, list[tuple[np.ndarray, np.ndarray]]] = {True: [], False: []}
    total = 0
    contrast = _contrast(capture, views)
    for row, frame in enumerate(frames):
        posed = PosedSurface(surface, mi.Float(capture.poses.vertices[capture.poses.index(frame)].ravel()), REACH)
        low, high = (np.array(corner, dtype=np.float64).ravel() for corner in (posed.bbox.min, posed.bbox.max))
        for view in (view for view in views if view.frame == row):
            total += int(view.mask.sum())
            camera = cameras[view.camera]
            for beside in (True, False):
                pixels = np.flatnonzero((view.mask & ~view.body if beside else view.body & ~view.mask).ravel())
                if not len(pixels):
                    continue
                y, x = np.divmod(pixels, camera.w)
                ray = camera.rays(mi.Point2f(mi.Float(x), mi.Float(y)) + 0.5)
                origin, direction = np.array(ray.o).T.astype(np.float64), np.array(ray.d).T.astype(np.float64)
                origin = np.broadcast_to(origin, direction.shape)
                distance = np.concatenate([_closest(posed, origin[i : i + _RAYS], direction[i : i + _RAYS], low, high)
                                           for i in range(0, len(pixels), _RAYS)])
                colour = view.image.reshape(-1, 3)[pixels]
                cost = np.mean((colour - capture.background) ** 2, axis=1) if beside else np.full(len(pixels), contrast)
                parts[beside].append((np.maximum(distance if beside else -distance, 0), cost))
    outside, inside = (Disagreement(*(np.concatenate([np.zeros(0), *(part[i] for part in parts[kind])]) for i in (0, 1)))
                       for kind in (True, False))
    return Standoff(outside, inside, total)


def _closest(posed: object, origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(N,) the least signed distance, metres, along each ray; `REACH` where nothing is near."""
    with np.errstate(divide="ignore"):
        a, b = (low - origin) / direction, (high - origin) / direction
    near, far = np.maximum(np.minimum(a, b).max(axis=1), 0), np.maximum(a, b).min(axis=1)
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    t = near[:, None] + np.maximum(far - near, 0)[:, None] * share
    points = (origin[:, None] + t[..., None] * direction[:, None]).reshape(-1, 3)
    x = mi.Point3f(np.ascontiguousarray(points.T, dtype=np.float32))
    found = posed.project(x)  # type: ignore[attr-defined]
    distance = np.where(np.array(found.valid), np.array(found.l), REACH)
    return np.asarray(distance.reshape(-1, _POINTS).min(axis=1), dtype=np.float64)


def _contrast(capture: Capture, views: Sequence[View]) -> float:
    """Mean squared difference of the performer from the background."""
    total = sum(float(((view.image[view.mask] - capture.background) ** 2).mean(axis=1).sum()) for view in views)
    return total / max(sum(int(view.mask.sum()) for view in views), 1)
