"""Vertex offsets fitted to masks alone: the outlines of the posed surface move to the outlines of the masks.

A point on the surface's outline that lies within the mask moves outwards along the outline's normal to where
the mask ends, however far that is; one that lies outside moves inwards. So clothes and hair are reached that
stand off by more than the length over which an image's gradient sees anything. Each round measures these
moves in a few frames and solves for the update δ of the offsets d

    (W + (h² + s²) C) δ = ω W m - s² C d,

with the moves m at the vertices on outlines, their weights W, a factor ω of over-relaxation, the cotangent
stiffness C (`smoothing`), the length h over which an update is smooth, and the length s below which the
offsets are smooth themselves. Rounds go from long h to short. This is registration by closest points (Amberg
et al. 2007, "Optimal Step Nonrigid ICP") with outlines in place of points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import splu

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.silhouette import Silhouettes, agreement
from ndf_mi.surface.contours import NEARER, SIDE, Contours, ContourSamples, projection_vjp
from ndf_mi.surface.degenerate import degenerate_triangles, repair
from ndf_mi.surface.outline_views import Views
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.smoothing import cotangent_stiffness, vertex_areas

SAMPLES = 768
"""Contour points a view."""

REACH = 0.12
"""Metres that a point moves at most in one round."""

SMOOTH = 0.008
"""s, metres."""

OVER = 1.5
"""ω: moves along one normal at a time are too short where several views see a vertex."""

RESIDUAL_LENGTH = 0.03
"""Metres over which the residual is smooth."""

TIKHONOV = 1e-6
"""Share of the vertices' areas in the weights: pieces of surface that no outline passes stay solvable."""

PINNINGS = 6
"""How often a round pins the vertices of triangles that its update would make degenerate, and solves again.
The update then fades towards them. `repair` alone lets most of the surface return for the sake of a few:
where moved and returned vertices meet, other triangles become degenerate.
"""

PIN = 1e6
"""Weight of a pinned vertex, in vertices of average weight."""

STEP = 0.5
"""Pixels between the places where a normal is searched for the mask's outline."""


@dataclass(frozen=True)
class Outlines:
    """How the outlines of surface and masks differ at each vertex, summed over views.

    Attributes:
        weight: (V,) metres of outline that have found the mask's.
        move: (V, 3) metres at rest, from the one outline to the other, times the weight.
        seen: (V,) metres of outline.
        squared: (V,) squared distance of the outlines, m², times `seen`.
    """

    weight: np.ndarray
    move: np.ndarray
    seen: np.ndarray
    squared: np.ndarray


@dataclass(frozen=True)
class Moves:
    """N points on the outline of the posed surface in one view, and where the mask's outline is.

    Attributes:
        start, end: (N,) indices of the vertices of each point's edge.
        position: (N,) position between them, in [0, 1].
        point: (N, 3) world, metres.
        direction: (N, 3) unit vectors, world: the outline's normal, away from the surface.
        distance: (N,) signed metres along it to the mask's outline, at most `REACH`.
        found: (N,) whether the mask's outline is there.
        length: (N,) metres of outline that each point represents.
    """

    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    distance: np.ndarray
    found: np.ndarray
    length: np.ndarray


class OutlineFit:
    """Offsets that follow the outlines of masks.

    Args:
        rest: of the capture.
        faces: (F, 3).
        seed: of the points on contours.

    Attributes:
        offsets: (V, 3) float64 metres, without degenerate triangles.
    """

    def __init__(self, rest: RestFrames, faces: np.ndarray, seed: int) -> None:
        self._rest, self._faces = rest, faces
        self._contours = Contours(faces)
        self._caster = Silhouettes(faces, len(rest.vertices))
        self._areas = vertex_areas(rest.vertices, faces)
        self._stiffness = cotangent_stiffness(rest.vertices, faces)
        self._random = np.random.default_rng([seed, 2])
        self.offsets = np.zeros((len(rest.vertices), 3))

    def step(self, views: Views, length: float) -> None:
        """One round.

        Args:
            views: what it sees.
            length: h, metres.
        """
        found = self.measure(views)
        pull = SMOOTH**2 * (self._stiffness @ self.offsets)
        pinned = np.zeros(len(self.offsets), dtype=bool)
        for _ in range(PINNINGS + 1):
            moved = self.offsets + self._solve(found.weight, length, OVER * found.move, pull, pinned)
            bad = degenerate_triangles(self._rest.vertices, moved, self._faces)
            if not bad.any():
                break
            pinned[self._faces[bad]] = True
        self.offsets = repair(self._rest.vertices, moved, self._faces, self.offsets)

    def shorten(self, length: float) -> None:
        """Shortens each offset by this length in metres, or to zero. No two come to lie further apart, so
        that the surface stays as smooth as it was."""
        norm = np.linalg.norm(self.offsets, axis=1, keepdims=True)
        shorter = self.offsets * np.maximum(0, 1 - length / np.maximum(norm, 1e-12))
        self.offsets = repair(self._rest.vertices, shorter, self._faces)

    def follow(self, rest: RestFrames) -> None:
        """Goes on with the same offsets around other poses or another shape of the same body."""
        self._rest = rest

    def moves(self, frame: int, views: Sequence[tuple[Camera, np.ndarray]],
              count: int = SAMPLES) -> list[Moves | None]:
        """Where the masks' outlines are from those of the surface, view by view; None where no contour is in
        front of the camera.

        Args:
            frame: of the capture.
            views: pinhole cameras and (h, w) mattes.
            count: contour points a view; those on the outline are returned.
        """
        posed = self._rest.posed(frame, self.offsets)
        self._caster.pose(posed)
        planes = self._contours.planes(posed)
        return [self._moves(posed, planes, camera, matte, count) for camera, matte in views]

    def check(self, views: Views) -> tuple[float, np.ndarray]:
        """`agreement`, and the residual: (V,) metres, the root mean square distance between the outlines of
        surface and masks, smoothed over the surface by `RESIDUAL_LENGTH`. Where no outline passes, it comes
        from the surroundings.
        """
        silhouettes, masks = list[np.ndarray](), list[np.ndarray]()
        found = self.measure(views, (silhouettes, masks))
        squared = self._solve(found.seen, RESIDUAL_LENGTH, found.squared[:, None])[:, 0]
        return agreement(silhouettes, masks), np.sqrt(np.maximum(squared, 0))

    def agreement(self, views: Views) -> float:
        """The mean intersection over union of masks and silhouettes."""
        silhouettes, masks = [], []
        for frame, seen in views.items():
            self._caster.pose(self._rest.posed(frame, self.offsets))
            silhouettes += [self._caster.draw(camera) for camera, _ in seen]
            masks += [matte >= 0.5 for _, matte in seen]
        return agreement(silhouettes, masks)

    def _solve(self, weight: np.ndarray, length: float, values: np.ndarray,
               pull: np.ndarray | float = 0.0, pinned: np.ndarray | None = None) -> np.ndarray:
        """(V, k) solution x of (W + (length² + SMOOTH²) C) x = values - pull, zero where `pinned`.

        Weights and values are scaled so that the weights sum to the surface's area: lengths then have their
        meaning on the average vertex.
        """
        total = weight.sum()
        if not total:
            return np.zeros(values.shape)
        scale = self._areas.sum() / total
        stiffness = (length**2 + SMOOTH**2) * self._stiffness
        diagonal = scale * weight + TIKHONOV * self._areas
        if pinned is not None:
            diagonal = np.where(pinned, PIN * self._areas.mean(), diagonal)
        matrix = sparse.csc_matrix(sparse.diags(diagonal) + stiffness)
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return np.asarray(factors.solve(np.ascontiguousarray(scale * values - pull)))

    def measure(self, views: Views,
                collected: tuple[list[np.ndarray], list[np.ndarray]] | None = None) -> Outlines:
        """How the outlines differ in these views.

        Args:
            views: what is compared.
            collected: lists that the silhouettes and the masks, (h, w) bool, are added to.
        """
        count = len(self.offsets)
        totals = np.zeros((count, 6))
        for frame, seen in views.items():
            posed = self._rest.posed(frame, self.offsets)
            self._caster.pose(posed)
            planes = self._contours.planes(posed)
            sums = np.zeros((count, 6))
            for camera, matte in seen:
                self._add(sums, posed, planes, camera, matte)
                if collected is not None:
                    collected[0].append(self._caster.draw(camera))
                    collected[1].append(matte >= 0.5)
            sums[:, 1:4] = self._rest.vjp(frame, sums[:, 1:4])
            totals += sums
        return Outlines(totals[:, 0], totals[:, 1:4], totals[:, 4], totals[:, 5])

    def _add(self, sums: np.ndarray, posed: np.ndarray, planes: np.ndarray, camera: Camera,
             matte: np.ndarray) -> None:
        """Adds a view to `sums` (V, 6): weight, move in world space, seen, squared."""
        found = self._moves(posed, planes, camera, matte, SAMPLES)
        if found is None:
            return
        weight = found.found * found.length
        move = (weight * found.distance)[:, None] * found.direction
        values = np.column_stack([weight, move, found.length, found.length * found.distance**2])
        for index, share in ((found.start, 1 - found.position), (found.end, found.position)):
            for column in range(6):
                sums[:, column] += np.bincount(index, share * values[:, column], minlength=len(sums))

    def _moves(self, posed: np.ndarray, planes: np.ndarray, camera: Camera, matte: np.ndarray,
               count: int) -> Moves | None:
        """See `moves`; the mesh that rays are cast at must be `posed`. None if no contour is in front of the
        camera.
        """
        samples = self._contours.sample(posed, camera, count, self._random, planes)
        if samples is None:
            return None
        chosen, side = self._outline(camera, samples)
        start, end, position = samples.start[chosen], samples.end[chosen], samples.position[chosen]
        normal = side[:, None] * samples.normal[chosen]
        pixels, found = self._distances(camera, matte, samples.point[chosen], normal,
                                        samples.distance[chosen])
        world = posed[start] + position[:, None] * (posed[end].astype(np.float64) - posed[start])
        along = projection_vjp(camera, world, normal)
        scale = np.linalg.norm(along, axis=1)
        return Moves(start, end, position, world, along / scale[:, None], pixels / scale, found,
                     samples.length / scale)

    def _outline(self, camera: Camera, samples: ContourSamples) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the samples that are visible and have the background on one side, and 1 or -1 for each:
        the direction of its normal that points there.
        """
        visible = np.flatnonzero(~self._caster.hits(camera, samples.point, samples.distance * NEARER))
        point, normal = samples.point[visible], samples.normal[visible]
        ahead, behind = (self._caster.hits(camera, point + side * SIDE * normal) for side in (1, -1))
        outer = ahead != behind
        return visible[outer], np.where(behind[outer], 1.0, -1.0)

    def _distances(self, camera: Camera, matte: np.ndarray, point: np.ndarray, normal: np.ndarray,
                   depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N,) signed pixels along the normals to the mask's outline, positive outwards, at most `REACH`; and
        (N,) whether it is there.

        A search outwards that finds the surface again takes half the distance to there: what lies between
        belongs to both parts. One inwards that leaves the surface first has found no outline.
        """
        if not len(point):
            return np.zeros(0), np.zeros(0, dtype=bool)
        inside = sampled(matte, point) >= 0.5
        reach = REACH * camera.fl_x / depth
        along = STEP * np.arange(int(np.ceil(reach.max() / STEP)) + 1)
        signed = np.where(inside, 1, -1)[:, None] * along
        places = (point[:, None] + signed[..., None] * normal[:, None]).reshape(-1, 2)
        values = sampled(matte, places).reshape(signed.shape)
        crossed = (values >= 0.5) != inside[:, None]
        first = crossed.argmax(axis=1)  # At 0 it is the point itself, which never counts.
        rows = np.arange(len(point))
        a, b = values[rows, first - 1], values[rows, first]
        distance = along[first] - STEP * (b - 0.5) / np.where(a == b, 1, b - a)
        distance = np.where(crossed.any(axis=1), distance, np.inf)
        turned = self._caster.hits(camera, places).reshape(signed.shape) == inside[:, None]
        turned[:, :2] = False
        met = np.where(turned.any(axis=1), along[turned.argmax(axis=1)], np.inf)
        outwards = np.minimum(np.minimum(distance, met / 2), reach)
        inwards = np.minimum(np.minimum(distance, met), reach)
        return np.where(inside, outwards, -inwards), inside | (distance <= inwards)


def sampled(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(N,) bilinear values of an (h, w) image at pixel coordinates (N, 2); 0 outside of it."""
    return map_coordinates(image, pixels.T[::-1] - 0.5, order=1, mode="constant")
